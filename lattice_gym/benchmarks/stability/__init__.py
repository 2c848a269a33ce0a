"""Stability: the predicted stable time step against the measured one."""
