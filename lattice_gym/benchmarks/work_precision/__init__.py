"""Work-precision: error against run time, over time step, mesh, damping, muscles and engine."""
