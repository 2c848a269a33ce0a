"""Pictures and videos of a worm, drawn off screen: no display is needed.

Rods and muscles are drawn thinner than they are, so that one sees into the lattice, and muscles taper at their ends, so
that one tells them from rods. Both thicken as they shorten, since their volume is kept.
"""
