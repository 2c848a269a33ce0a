"""Divergence: whether every run that goes wrong is caught, and no other."""
