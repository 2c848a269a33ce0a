"""Validation: every exact case and every order of convergence, on both engines."""
