"""One file a law: its parameters, units, source, energy, part of the critical time step and plain formula."""
