"""The reference engine, made of PyElastica's own rods, joints, constraints and stepper."""
