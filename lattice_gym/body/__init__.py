"""What is built: the design of a lattice, its rods and crossings at rest, and the muscles patterned on them."""
