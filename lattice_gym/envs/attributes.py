"""What the environment of one worm and that of many tell alike of their scene."""

from __future__ import annotations

import numpy.typing as npt

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice
from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.envs.actions import to_action
from lattice_gym.envs.core import Worms
from lattice_gym.envs.scene import Scene
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.laws.adaptation import Adaptation
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.world import World
from lattice_gym.tasks.base import Task


class SceneAttributes:
    """Attributes that an environment has from its scene and worms."""

    scene: Scene
    """All that its worms have in common."""
    worms: Worms
    """Its worms, a row each."""

    @property
    def task(self) -> Task:
        """What is asked of the worms."""
        return self.worms.task

    @property
    def design(self) -> LatticeDesign:
        """Parameters of the body, as meshed."""
        return self.scene.design

    @property
    def lattice(self) -> Lattice:
        """The body at rest."""
        return self.scene.lattice

    @property
    def layout(self) -> MuscleLayout:
        """Its muscles."""
        return self.scene.layout

    @property
    def world(self) -> World:
        """What surrounds it."""
        return self.scene.world

    @property
    def model(self) -> RodModel:
        """The assembly of all of it, before any randomisation."""
        return self.scene.model

    @property
    def groups(self) -> IntArray:
        """Control group of every active muscle, shape (n_muscle,)."""
        return self.scene.groups

    @property
    def action_range(self) -> tuple[float, float]:
        """Least and largest number of an action, which stand for the commands 0 and 1."""
        return self.scene.action_range

    def action_of(self, command: npt.ArrayLike) -> FloatArray:
        """Return the action that stands for commands from 0 to 1 of every control group, shape (..., n_group) both.

        With a gait: `env.step(env.unwrapped.action_of(group_means(gait(time), groups)))`.
        """
        return to_action(command, self.scene.action_range)

    @property
    def adaptation(self) -> Adaptation | None:
        """How use changes the strength of muscles; None: not at all."""
        return self.scene.adaptation

    @property
    def control_dt(self) -> float:
        """Time between actions [s]."""
        return self.scene.control_dt

    @property
    def dt(self) -> float:
        """Time step of the physics [s]."""
        return self.scene.dt

    @property
    def n_substeps(self) -> int:
        """Physics steps in a control step."""
        return self.scene.n_substeps

    @property
    def splitting(self) -> Splitting:
        """When velocities are damped."""
        return self.scene.splitting

    @property
    def observation_slices(self) -> dict[str, slice]:
        """Where each term stands in the (flat) observation of a worm, by name."""
        return dict(self.worms.observer.slices)
