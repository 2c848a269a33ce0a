"""Observation terms of your own: `observation=["sites", "activation", "command", "upright:Tilt"]`."""

import numpy as np

from lattice_gym import ObservationTerm


class Tilt(ObservationTerm):
    """Angle of the top from upright, and how fast the top moves sideways."""

    name = "tilt"
    unit = "rad; height/s"

    def __init__(self, scene):
        """Set the bounds, and keep what is needed of body and task."""
        self.height = scene.design.height
        self.low, self.high = np.array([0.0, 0.0]), np.array([np.pi, 20.0])

    def __call__(self, worms):
        """Return the numbers now, shape (n_worm, 2)."""
        angle = np.arccos(np.clip(worms.measures.top_normal[:, 2], -1.0, 1.0))
        speed = np.linalg.norm(worms.measures.top_velocity[:, :2], axis=1) / self.height
        return np.stack([angle, speed], axis=1)
