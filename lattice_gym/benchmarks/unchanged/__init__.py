"""Unchanged: states, observations, rewards and run times beside those of an older commit."""
