"""What moves and by which laws: rods, assemblies of them, states, measures, energy, the critical step."""
