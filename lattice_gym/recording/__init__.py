"""What an episode or a report leaves on disk."""
