"""Stability: the predicted critical time step against the measured one."""
