"""What a worm did over one episode, and the file that keeps it."""

from __future__ import annotations

import io
import json
import os
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import build_lattice
from lattice_gym.body.muscles import MuscleLayout, resolve_layout
from lattice_gym.checks import FloatArray, finite_number, real_array, shown
from lattice_gym.physics.world import World
from lattice_gym.recording.files import replacing

FORMAT = "lattice_gym trajectory"
VERSION = 3
OLD_VERSION = 2
"""Without markers."""
ARRAYS = {
    "time": np.float64,
    "position": np.float32,
    "bolus": np.float32,
    "activation": np.float32,
    "reward": np.float64,
    "markers": np.float32,
}
META = ("format", "version", "task", "outcome", "design", "layout", "world")
Frame = npt.NDArray[np.float32]
# Activations may leave [0, 1] by no more than rounding to float32.
ACTIVATION_TOLERANCE = 1e-6


def n_nodes(design: LatticeDesign, layout: MuscleLayout) -> int:
    """Nodes of the structure rods and of the active muscles together; muscles as lines have none."""
    per_rod = design.n_segment * design.elements_per_segment + 1
    per_muscle = design.elements_per_muscle + 1 if design.muscle_model == "rod" else 0
    return design.n_rod * per_rod + len(layout) * per_muscle


def n_bolus(world: World) -> int:
    """Balls in a world: 0 or 1."""
    if not isinstance(world, World):
        raise ValueError(f"Trajectory.world = {shown(world)}: must be a World")
    return 0 if world.bolus is None else 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """Recorded frames of one episode; the arrays are read-only copies.

    The design and the layout say which nodes form which rod: structure rods first, then the active muscles in order.
    Wrong shapes, non-finite numbers, times that do not increase and activations outside [0, 1] are a ValueError.
    """

    time: FloatArray
    """Times of the frames [s], increasing, shape (n_frame,)."""
    position: npt.NDArray[np.float32]
    """Node positions [m], shape (n_frame, n_node, 3)."""
    activation: npt.NDArray[np.float32]
    """Activations of the active muscles, in [0, 1], shape (n_frame, n_muscle)."""
    reward: FloatArray
    """Reward of the control step that ended at each frame, shape (n_frame,)."""
    outcome: tuple[str, ...]
    """One line per frame to print in its picture; may be empty."""
    design: LatticeDesign
    layout: MuscleLayout
    task: str
    world: World = field(default_factory=World)
    bolus: npt.NDArray[np.float32] | None = None
    """Places of the ball [m], shape (n_frame, n_bolus, 3), n_bolus 1 in a world that has one and else 0; None: none."""

    markers: npt.NDArray[np.float32] | None = None
    """Places that the task asked for [m], to mark in every picture, shape (n_marker, 3); None: none."""

    def __post_init__(self) -> None:
        """Check everything against everything else."""
        if not isinstance(self.design, LatticeDesign) or not isinstance(self.layout, MuscleLayout):
            name = "layout" if isinstance(self.design, LatticeDesign) else "design"
            raise ValueError(
                f"Trajectory.{name} = {shown(getattr(self, name))}: must be a LatticeDesign, a MuscleLayout"
            )
        resolve_layout(self.layout, build_lattice(self.design))
        n_frame, n_muscle = np.size(self.time), len(self.layout)
        shapes = {
            "time": (n_frame,),
            "position": (n_frame, n_nodes(self.design, self.layout), 3),
            "bolus": (n_frame, n_bolus(self.world), 3),
            "activation": (n_frame, n_muscle),
            "reward": (n_frame,),
            "markers": (0 if self.markers is None else np.size(self.markers) // 3, 3),
        }
        if self.markers is None:
            object.__setattr__(self, "markers", np.empty((0, 3)))
        if self.bolus is None:
            object.__setattr__(self, "bolus", np.empty((n_frame, 0, 3)))
        if n_frame == 0:
            raise ValueError("Trajectory.time is empty: must hold at least one frame")
        for name, shape in shapes.items():
            object.__setattr__(self, name, _checked(name, getattr(self, name), shape))
        back = np.flatnonzero(np.diff(self.time) <= 0.0)
        if back.size:
            raise ValueError(f"Trajectory.time: must increase; frame {back[0] + 1} is not later than frame {back[0]}")
        if n_muscle and np.max(np.abs(self.activation - 0.5)) > 0.5 + ACTIVATION_TOLERANCE:
            low, high = self.activation.min(), self.activation.max()
            raise ValueError(f"Trajectory.activation spans {low:g} to {high:g}: must lie in [0, 1]")
        if not isinstance(self.outcome, tuple | list):
            raise ValueError(f"Trajectory.outcome = {shown(self.outcome)}: must be a tuple of text, one a frame")
        object.__setattr__(self, "outcome", tuple(self.outcome))
        if len(self.outcome) != n_frame:
            raise ValueError(f"Trajectory.outcome has {len(self.outcome)} lines: must have one a frame, {n_frame}")
        for name, text in (("task", self.task), *(("outcome", line) for line in self.outcome)):
            if not isinstance(text, str):
                raise ValueError(f"Trajectory.{name} holds {text!r}: must be text")

    @property
    def n_frame(self) -> int:
        """Number of frames."""
        return len(self.time)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz file that numpy reads without pickle; replaces a file of that name once it is complete."""
        meta = {
            "format": FORMAT,
            "version": VERSION,
            "task": self.task,
            "outcome": list(self.outcome),
            "design": self.design.to_json(),
            "layout": json.dumps(self.layout.to_dict()),
            "world": json.dumps(self.world.to_dict()),
        }
        arrays: dict[str, npt.NDArray[Any]] = {name: getattr(self, name) for name in ARRAYS}
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, meta=np.array(json.dumps(meta)), **arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a saved trajectory; a file that is damaged, foreign or at odds with itself is a ValueError naming it."""
        content = Path(path).read_bytes()
        try:
            # Members are unpacked whole, so that their checksums are compared before a byte of them is interpreted.
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                packed = {name: archive.read(name) for name in archive.namelist()}
        except Exception as error:  # Damage surfaces as any of a dozen exceptions of zipfile and its decompressors.
            raise ValueError(f"{path}: damaged, or not an .npz file: {error}") from error
        try:
            return cls(**_unpacked(packed))
        except Exception as error:  # numpy's reader of array headers lets through what Python's own parsers raise.
            raise ValueError(f"{path}: not a sound {FORMAT}: {error}") from error


class Recorder:
    """Collects frames, then builds the trajectory."""

    def __init__(self, design: LatticeDesign, layout: MuscleLayout, task: str, world: World | None = None) -> None:
        self._design, self._layout, self._task = design, layout, task
        self._world = World() if world is None else world
        self._shapes = {
            "position": (n_nodes(design, layout), 3),
            "activation": (len(layout),),
            "bolus": (n_bolus(self._world), 3),
        }
        self._frames: list[tuple[float, Frame, Frame, float, str, Frame]] = []

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
        bolus: npt.ArrayLike | None = None,
    ) -> None:
        """Copy a frame.

        Time [s], positions (n_node, 3) [m], activations (n_muscle,), reward, line for the picture, and the place of the
        ball (n_bolus, 3) [m] in a world that has one.
        """
        x = _checked("position", position, self._shapes["position"])
        a = _checked("activation", activation, self._shapes["activation"])
        b = _checked("bolus", np.empty((0, 3)) if bolus is None else bolus, self._shapes["bolus"])
        numbers = {"time": finite_number(time), "reward": finite_number(reward)}
        for name, number in numbers.items():
            if number is None:
                raise ValueError(f"{name} = {shown(time if name == 'time' else reward)}: must be a finite number")
        if not isinstance(outcome, str):
            raise ValueError(f"outcome = {shown(outcome)}: must be text")
        self._frames.append((float(time), x, a, float(reward), outcome, b))

    def build(self, markers: npt.ArrayLike | None = None) -> Trajectory:
        """Trajectory of the frames so far, of which there must be one, with places to mark (n_marker, 3) [m]."""
        if not self._frames:
            raise ValueError("Recorder holds no frame: append at least one before build()")
        time, position, activation, reward, outcome, bolus = zip(*self._frames, strict=True)
        return Trajectory(
            time=np.array(time),
            position=np.stack(position),
            activation=np.stack(activation),
            reward=np.array(reward),
            outcome=outcome,
            design=self._design,
            layout=self._layout,
            task=self._task,
            world=self._world,
            bolus=np.stack(bolus),
            markers=None if markers is None else np.asarray(markers),
        )


def _checked(name: str, values: npt.ArrayLike, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """Read-only copy of values as the dtype of a trajectory's array, which must have the shape and be finite."""
    with np.errstate(over="ignore"):  # What float32 cannot hold becomes infinite and is refused below.
        array = real_array(f"Trajectory.{name}", values).astype(ARRAYS[name])
    if array.shape != shape:
        raise ValueError(f"Trajectory.{name} has shape {array.shape}: must have {shape}")
    if not np.all(np.isfinite(array)):
        raise ValueError(f"Trajectory.{name}: must be finite")
    array.setflags(write=False)
    return array


def _array(data: bytes) -> npt.NDArray[Any]:
    return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)


def _unpacked(packed: dict[str, bytes]) -> dict[str, Any]:
    """Arguments of Trajectory from the members of its file."""
    expected, version = {f"{name}.npy" for name in ("meta", *ARRAYS)}, VERSION
    if "markers.npy" not in packed:
        expected, version = expected - {"markers.npy"}, OLD_VERSION
    if set(packed) != expected:
        raise ValueError(f"it holds {', '.join(sorted(packed)) or 'nothing'}; must hold {', '.join(sorted(expected))}")
    members = {name.removesuffix(".npy"): _array(data) for name, data in packed.items()}
    for name in (name for name in ARRAYS if name in members):
        if members[name].dtype.kind != "f":
            raise ValueError(f"{name} holds {members[name].dtype}: must hold floating-point numbers")
    text = members.pop("meta")
    if text.shape != () or text.dtype.kind != "U":
        raise ValueError(f"meta is an array of {text.dtype} with shape {text.shape}: must be one text")
    meta = json.loads(text.item())
    if not isinstance(meta, dict) or set(meta) != set(META):
        raise ValueError(f"meta must be a mapping of {', '.join(META)}")
    if meta["format"] != FORMAT or meta["version"] != version:
        raise ValueError(f"it is {meta['format']!r} version {meta['version']!r}; must be version {version}")
    if not isinstance(meta["outcome"], list) or not all(isinstance(meta[name], str) for name in ("layout", "world")):
        raise ValueError("meta: outcome must be a list, layout and world JSON text")
    return {
        **members,
        "task": meta["task"],
        "outcome": tuple(meta["outcome"]),
        "design": LatticeDesign.from_json(meta["design"]),
        "layout": MuscleLayout.from_dict(json.loads(meta["layout"])),
        "world": World.from_dict(json.loads(meta["world"])),
    }
