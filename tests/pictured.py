"""What tests of pictures and films draw."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray
from lattice_gym.physics.assembly import RodModel
from lattice_gym.rendering.extras import extra

imageio_ffmpeg = extra("imageio_ffmpeg")
SIZE = (160, 120)
STRETCH = np.array([0.8, 0.8, 1.6])


def rest_of(model: RodModel) -> FloatArray:
    """Rest positions of a model's nodes."""
    return model.rest_state().position


def green(picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """Where a picture shows markers."""
    red, middle, blue = picture.astype(int).transpose(2, 0, 1)
    return np.asarray((middle > red + 40) & (middle > blue + 20))
