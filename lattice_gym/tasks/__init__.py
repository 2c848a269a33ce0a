"""What a worm is asked to do: one file a task."""
