"""One file a law: its parameters, units, source, energy, bound for the stable step and plain formula."""
