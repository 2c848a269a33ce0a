"""What a worm did over one episode, and the file that keeps it."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import MuscleLayout, resolve_layout
from lattice_gym.checks import FloatArray, array, instance, invalid_value, items, number, require
from lattice_gym.physics.world import World
from lattice_gym.recording.archive import read_members, unpack, unpack_meta, write_archive

FORMAT = "lattice_gym trajectory"
VERSION, OLD_NAME_VERSION, UNMARKED_VERSION = 4, 3, 2
"""Version of the format that is written, and two before it, which are read too: 3 calls the ball "bolus", and so does
2, which has no markers."""
ARRAYS: dict[str, npt.DTypeLike] = {
    "time": np.float64,
    "position": np.float32,
    "ball": np.float32,
    "activation": np.float32,
    "reward": np.float64,
    "markers": np.float32,
}
"""Arrays of a file, and the type of their numbers."""
META = ("format", "version", "task", "outcome", "design", "layout", "world")
"""What a file says beside its arrays, as one JSON text."""
ACTIVATION_RANGE = (-1e-6, 1.0 + 1e-6)
"""Bounds of activations: [0, 1] and what rounding to float32 adds."""
Frame = npt.NDArray[np.float32]


def n_nodes(design: LatticeDesign, layout: MuscleLayout) -> int:
    """Nodes of the structure rods and of the active muscles together; muscles as lines have none."""
    per_rod = design.n_segment * design.elements_per_segment + 1
    per_muscle = design.elements_per_muscle + 1 if design.muscle_model == "rod" else 0
    return design.n_rod * per_rod + len(layout) * per_muscle


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """Recorded frames of one episode, and the worm and the world that they show; the arrays are read-only copies.

    Rows of nodes are those of the design's structure rods, one rod after another, then of the layout's active muscles
    in order; muscles as lines have none.

    Raises
    ------
    ValueError
        A wrong shape or kind, a number that is not finite, times that do not increase, an activation outside [0, 1], a
        layout of another lattice.
    """

    time: FloatArray
    """Times of the frames [s], increasing, shape (n_frame,)."""
    position: Frame
    """Node positions [m], shape (n_frame, n_node, 3)."""
    activation: Frame
    """Activations of the active muscles, in [0, 1], shape (n_frame, n_muscle)."""
    reward: FloatArray
    """Reward of the control step that ended at each frame, shape (n_frame,)."""
    outcome: tuple[str, ...]
    """One line per frame to print in its picture; may be empty."""
    design: LatticeDesign
    """The worm's."""
    layout: MuscleLayout
    """Its muscles, on or off."""
    task: str
    """Name of what was asked of the worm."""
    world: World = field(default_factory=World)
    """What was around it."""
    ball: Frame | None = None
    """Places of the ball [m], shape (n_frame, n_ball, 3), n_ball 1 in a world that has one and else 0; None: none."""
    markers: Frame | None = None
    """Places that the task asked for [m], to mark in every picture, shape (n_marker, 3); None: none."""

    def __post_init__(self) -> None:
        """Check everything against everything else."""
        instance("Trajectory.design", self.design, LatticeDesign)
        instance("Trajectory.layout", self.layout, MuscleLayout)
        instance("Trajectory.world", self.world, World)
        resolve_layout(self.layout, build_lattice(self.design))
        n_frame = len(array("Trajectory.time", self.time, ("n_frame",)))
        require(n_frame > 0, "Trajectory.time is empty: must hold at least one frame")
        of_frame = _shapes(self.design, self.layout, self.world)
        if self.ball is None:
            object.__setattr__(self, "ball", np.empty((n_frame, 0, 3)))
        if self.markers is None:
            object.__setattr__(self, "markers", np.empty((0, 3)))
        for name in ARRAYS:
            shape = ("n_marker", 3) if name == "markers" else (n_frame, *of_frame[name])
            values = _checked(f"Trajectory.{name}", getattr(self, name), shape, name)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        back = np.flatnonzero(np.diff(self.time) <= 0.0)
        if back.size:
            raise ValueError(f"Trajectory.time: must increase; frame {back[0] + 1} is not later than frame {back[0]}")
        _text("Trajectory.task", self.task)
        lines = items("Trajectory.outcome", self.outcome, _text, n_frame, "lines of text, one a frame")
        object.__setattr__(self, "outcome", lines)

    def __repr__(self) -> str:
        span = f"{self.n_frame} frames from {self.time[0]:g} to {self.time[-1]:g} s"
        worm = f"{self.position.shape[1]} nodes, {len(self.layout)} muscles"
        marked = 0 if self.markers is None else len(self.markers)
        return f"Trajectory({self.task}: {span}, {worm}{', a ball' * bool(self.world.ball)}, {marked} markers)"

    @property
    def n_frame(self) -> int:
        """Number of frames."""
        return len(self.time)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz file that numpy reads without pickle; it replaces a file of that name once it is complete."""
        meta = {
            "format": FORMAT,
            "version": VERSION,
            "task": self.task,
            "outcome": list(self.outcome),
            "design": self.design.to_json(),
            "layout": json.dumps(self.layout.to_dict()),
            "world": json.dumps(self.world.to_dict()),
        }
        write_archive(path, meta, {name: getattr(self, name) for name in ARRAYS})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a saved trajectory; a file that is damaged, foreign or at odds with itself is a ValueError naming it."""
        members = read_members(path)
        try:
            return cls(**_arguments(members))
        except Exception as error:  # numpy's reader of array headers lets through what Python's own parsers raise.
            raise ValueError(f"{path}: not a sound {FORMAT}: {error}") from error


class Recorder:
    """Collects the frames of an episode of a worm in a world, then builds their trajectory."""

    def __init__(self, design: LatticeDesign, layout: MuscleLayout, task: str, world: World | None = None) -> None:
        world = World() if world is None else instance("Trajectory.world", world, World)
        self._worm: dict[str, Any] = {"design": design, "layout": layout, "task": task, "world": world}
        self._shapes = _shapes(design, layout, world)
        self._frames: list[dict[str, Any]] = []

    def __len__(self) -> int:
        """Return the number of frames so far."""
        return len(self._frames)

    def append(
        self,
        time: float,
        position: npt.ArrayLike,
        activation: npt.ArrayLike,
        reward: float = 0.0,
        outcome: str = "",
        ball: npt.ArrayLike | None = None,
    ) -> None:
        """Copy a frame.

        Time [s], positions (n_node, 3) [m], activations (n_muscle,), reward, line for the picture, and the place of the
        ball (n_ball, 3) [m] in a world that has one. What is wrong is refused here, with a ValueError, not later.
        """
        arrays = {"position": position, "activation": activation, "ball": np.empty((0, 3)) if ball is None else ball}
        self._frames.append(
            {
                "time": number("time", time, unit="s"),
                "reward": number("reward", reward),
                "outcome": _text("outcome", outcome),
                **{name: _checked(name, values, self._shapes[name], name) for name, values in arrays.items()},
            }
        )

    def build(self, markers: npt.ArrayLike | None = None) -> Trajectory:
        """Trajectory of the frames so far, of which there must be one, with places to mark (n_marker, 3) [m]."""
        require(len(self) > 0, "Recorder holds no frame: append at least one before build()")
        frames = {name: [frame[name] for frame in self._frames] for name in self._frames[0]}
        outcome = tuple(frames.pop("outcome"))
        arrays: dict[str, Any] = {name: np.array(values) for name, values in frames.items()}
        return Trajectory(
            **arrays, **self._worm, outcome=outcome, markers=None if markers is None else np.asarray(markers)
        )


def _shapes(design: LatticeDesign, layout: MuscleLayout, world: World) -> dict[str, tuple[int, ...]]:
    """Shape of what each array holds of one frame."""
    n_ball = 0 if world.ball is None else 1
    arrays = {"position": (n_nodes(design, layout), 3), "activation": (len(layout),), "ball": (n_ball, 3)}
    return {"time": (), "reward": (), **arrays}


def _checked(label: str, values: npt.ArrayLike, shape: tuple[int | str, ...], name: str) -> npt.NDArray[Any]:
    """Copy of values as a trajectory keeps the array of a name."""
    bounds = ACTIVATION_RANGE if name == "activation" else ()
    return array(label, values, shape, *bounds, dtype=ARRAYS[name])


def _text(name: str, value: object) -> str:
    if isinstance(value, str):
        return value
    raise invalid_value(name, value, "must be text")


def _arguments(members: dict[str, bytes]) -> dict[str, Any]:
    """Arguments of Trajectory from the members of its file."""
    version, known = VERSION, list(ARRAYS)
    if "bolus.npy" in members:
        version = OLD_NAME_VERSION
        members = {name.replace("bolus", "ball"): content for name, content in members.items()}
    if "markers.npy" not in members:
        version = UNMARKED_VERSION
        known.remove("markers")
    arrays, meta = unpack(members, known), unpack_meta(members, META)
    if meta["format"] != FORMAT or meta["version"] != version:
        raise ValueError(f"it is {meta['format']!r} version {meta['version']!r}; must be version {version}")
    if not isinstance(meta["outcome"], list) or not all(isinstance(meta[name], str) for name in ("layout", "world")):
        raise ValueError("meta: outcome must be a list, layout and world JSON text")
    world = json.loads(meta["world"])
    return {
        **arrays,
        "task": meta["task"],
        "outcome": tuple(meta["outcome"]),
        "design": LatticeDesign.from_json(meta["design"]),
        "layout": MuscleLayout.from_dict(json.loads(meta["layout"])),
        "world": World.from_dict(world if version == VERSION else _of_before(world)),
    }


def _of_before(world: dict[str, Any]) -> dict[str, Any]:
    """World of an older file, in which the ball had another name."""
    return {"ball" if name == "bolus" else name: part for name, part in world.items()}
