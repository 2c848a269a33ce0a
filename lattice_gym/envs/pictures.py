"""Pictures of worms as they are now; the graphics libraries are loaded with the first one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lattice_gym.envs.core import Worms

if TYPE_CHECKING:
    from lattice_gym.rendering.scene import Renderer

RENDER_MODES = ("rgb_array",)


class Pictures:
    """Draws any of some worms, for any thread."""

    def __init__(self, worms: Worms) -> None:
        self._worms = worms
        self.renderer: Renderer | None = None

    def draw(self, worm: int = 0) -> npt.NDArray[np.uint8]:
        """Picture of a worm and of what it is to reach, with its time and outcome, shape (480, 640, 3)."""
        worms, scene = self._worms, self._worms.scene
        worms.engine.require_idle()
        markers = worms.task.markers(worm)
        if self.renderer is None:
            from lattice_gym.rendering.scene import Renderer

            self.renderer = Renderer(scene.lattice, scene.model, n_marker=len(markers))
        motion = worms.motion
        caption = worms.task.caption(motion.rows(np.array([worm])), worm)
        shown = motion.position[worm], worms.activation[worm], float(worms.time[worm])
        return self.renderer.update(*shown, caption, motion.ball_position[worm], markers)

    def close(self) -> None:
        """Free the renderer; a later picture would make a new one."""
        if self.renderer is not None:
            self.renderer.close()
            self.renderer = None

    def __getstate__(self) -> dict[str, Any]:
        """All but the renderer, which is made anew."""
        return {**vars(self), "renderer": None}
