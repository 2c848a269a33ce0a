"""Exact cases and orders of convergence, which tests and reports use.

`case` says what a case is, `cases` lists them all; each of the other files holds those of one subject.
"""
