"""Exact cases and orders of convergence, which tests and reports use."""
