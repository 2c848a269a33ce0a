"""Pictures and videos of a worm, drawn off screen: no display is needed.

Rods and muscles are drawn thinner than they are, so that one sees into the lattice, and muscles taper at their ends, so
that one tells them from rods. Both thicken as they shorten, since their volume is kept.
"""

from lattice_gym.rendering.colours import activation_colour
from lattice_gym.rendering.figures import Still, plot_activation, render_still, render_strip
from lattice_gym.rendering.scene import Renderer, render_frame
from lattice_gym.rendering.video import render_video

__all__ = [
    "Renderer",
    "Still",
    "activation_colour",
    "plot_activation",
    "render_frame",
    "render_still",
    "render_strip",
    "render_video",
]
