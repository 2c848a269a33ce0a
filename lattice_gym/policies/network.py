"""A trained policy as arrays: a network of dense layers that numpy alone plays, and its file."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray, array, choice, invalid_value, items, names, require, without_imports
from lattice_gym.recording.archive import read_members, unpack, unpack_meta, write_archive

FORMAT, VERSION = "lattice_gym policy", 1
META = ("format", "version", "activation", "environment", "origin")
"""What a file says beside its arrays, as one JSON text."""
ARRAYS = ("shift", "scale", "limit", "low", "high")
"""Arrays of a file beside those of its layers: weight_0, bias_0, weight_1 and so on."""
OWN_ENTRY = "lattice_gym.envs."
"""Where ids of worms point to."""


def _relu(values: FloatArray) -> FloatArray:
    return np.maximum(values, 0.0)


ACTIVATIONS: dict[str, Callable[[FloatArray], FloatArray]] = {"tanh": np.tanh, "relu": _relu}
"""What hidden layers apply, by name."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NetworkPolicy:
    """A policy that is a network: observation to action, for one worm or a batch, by numpy alone.

    The observation is normalised, ``clip((observation - shift) / scale, -limit, limit)``, and rounded to float32; then
    come layers ``weight @ x + bias``, with the activation after each but the last, and the clip to [low, high]. All
    else is reckoned in double precision, so actions are the network's own to rounding to float32, and of a batch each
    is what it is alone, to the last bit.

    Raises
    ------
    ValueError
        Arrays that do not fit each other or hold what is not finite, an activation that there is none of.
    """

    weights: tuple[FloatArray, ...]
    """Of each layer, shape (n_out, n_in)."""
    biases: tuple[FloatArray, ...]
    """Of each layer, shape (n_out,)."""
    activation: str = "tanh"
    """What hidden layers apply, "tanh" or "relu"."""
    shift: FloatArray
    """Mean of each number observed, shape (n_observation,)."""
    scale: FloatArray
    """Spread of each number observed, shape (n_observation,)."""
    limit: FloatArray
    """Bound of the normalised observation, shape ()."""
    low: FloatArray
    """Least action, shape (n_action,)."""
    high: FloatArray
    """Largest action, shape (n_action,)."""
    environment: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of `gymnasium.make` for the environment that it acts in, JSON-safe; empty where that is not known."""
    origin: Mapping[str, Any] = field(default_factory=dict)
    """How it was trained, JSON-safe; `agents.policies` writes steps, sessions and seeds."""

    def __post_init__(self) -> None:
        """Check everything against everything else."""
        choice("NetworkPolicy.activation", self.activation, ACTIVATIONS)
        weights = items("NetworkPolicy.weights", self.weights, partial(_frozen, shape=("n_out", "n_in")))
        require(len(weights) > 0, "NetworkPolicy.weights = (): must have at least one layer")
        shapes = [(len(weight),) for weight in weights]
        biases = items("NetworkPolicy.biases", self.biases, _frozen, len(weights), "arrays, one a layer")
        for layer, (bias, shape) in enumerate(zip(biases, shapes, strict=True)):
            _frozen(f"NetworkPolicy.biases[{layer}]", bias, shape)
        for layer, (before, after) in enumerate(pairwise(weights), 1):
            _frozen(f"NetworkPolicy.weights[{layer}]", after, (len(after), len(before)))
        seen, acted = (weights[0].shape[1],), shapes[-1]
        given = {"shift": seen, "scale": seen, "limit": (), "low": acted, "high": acted}
        known = {name: _frozen(f"NetworkPolicy.{name}", getattr(self, name), shape) for name, shape in given.items()}
        require(bool((known["scale"] > 0.0).all()), "NetworkPolicy.scale: must be above 0")
        require(bool(known["limit"] > 0.0), "NetworkPolicy.limit: must be above 0")
        require(bool((known["low"] <= known["high"]).all()), "NetworkPolicy.low: must not be above high")
        for name in ("environment", "origin"):
            names(f"NetworkPolicy.{name}", getattr(self, name), getattr(self, name))
        for name, value in (known | {"weights": weights, "biases": biases}).items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        widths = [self.weights[0].shape[1], *(len(bias) for bias in self.biases)]
        return f"NetworkPolicy({' -> '.join(map(str, widths))}, {self.activation})"

    def __call__(self, observation: npt.ArrayLike) -> npt.NDArray[np.float32]:
        """Act on an observation, shape (n_observation,) to (n_action,), or on a batch of them, (n, ...) both."""
        if isinstance(observation, Mapping):
            raise invalid_value("observation", observation, "must be an array, not one whose goals are apart")
        seen = np.asarray(observation)
        if seen.ndim not in (1, 2) or seen.shape[-1] != len(self.shift) or seen.dtype.kind not in "fiu":
            shapes = f"({len(self.shift)},) or (n, {len(self.shift)})"
            raise ValueError(f"observation: must be numbers of shape {shapes}, got {seen.dtype} of shape {seen.shape}")
        normalised = np.clip((seen - self.shift) / self.scale, -self.limit, self.limit).astype(np.float32)
        # A matrix times one column for each row of a batch: so each is reckoned as it would be alone.
        values = normalised.astype(np.float64)[..., None]
        apply = ACTIVATIONS[self.activation]
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True), 1):
            values = weight @ values + bias[:, None]
            if layer < len(self.weights):
                values = apply(values)
        return np.clip(values[..., 0], self.low, self.high).astype(np.float32)

    def reset(self, env: gymnasium.Env[Any, Any], seed: int) -> None:
        """Refuse an environment whose observations or actions are not this policy's, with a ValueError."""
        own = (self.shift.shape, self.low.shape)
        if (given := (env.observation_space.shape, env.action_space.shape)) != own:
            raise ValueError(f"policy: observations and actions have shape {own}, those of the environment {given}")
        space: Any = env.action_space
        if not (np.allclose(space.low, self.low) and np.allclose(space.high, self.high)):
            raise ValueError(
                f"policy: gives actions from {self.low[0]:g} to {self.high[0]:g}, the environment takes "
                f"{space.low[0]:g} to {space.high[0]:g}: make it with action_range=({self.low[0]:g}, {self.high[0]:g})"
            )

    def in_range(self, low: float, high: float) -> NetworkPolicy:
        """Policy of the same commands whose actions lie in another range, as in `LatticeWormEnv(action_range=...)`."""
        factor = (high - low) / (self.high - self.low)
        return replace(
            self,
            weights=(*self.weights[:-1], factor[:, None] * self.weights[-1]),
            biases=(*self.biases[:-1], factor * self.biases[-1] + (low - factor * self.low)),
            low=np.full_like(self.low, low),
            high=np.full_like(self.high, high),
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz file that numpy reads without pickle; it replaces a file of that name once it is complete.

        A ValueError where environment or origin hold what JSON cannot.
        """
        meta = {
            "format": FORMAT,
            "version": VERSION,
            "activation": self.activation,
            "environment": dict(self.environment),
            "origin": dict(self.origin),
        }
        arrays = {name: getattr(self, name) for name in ARRAYS}
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            arrays |= {f"weight_{layer}": weight, f"bias_{layer}": bias}
        try:
            write_archive(path, meta, arrays)
        except TypeError as error:
            must = "must hold what JSON does: give the dict form of an object, .tolist() of an array"
            raise ValueError(f"NetworkPolicy.environment, NetworkPolicy.origin: {must} ({error})") from None


def load_policy(path: str | os.PathLike[str]) -> NetworkPolicy:
    """Read a policy that `NetworkPolicy.save` or `python -m agents.export` wrote.

    Nothing in the file is run or imported. Where its environment names a task or a term of somebody's own, as
    "module:Class", import that module before.

    Raises
    ------
    ValueError
        A file that is damaged, foreign, at odds with itself, or that names code which is not imported; it is named.
    """
    members = read_members(path)
    try:
        layers = range((len(members) - len(ARRAYS) - 1) // 2)
        parts = [f"{part}_{layer}" for layer in layers for part in ("weight", "bias")]
        arrays, meta = unpack(members, [*ARRAYS, *parts]), unpack_meta(members, META)
        if meta["format"] != FORMAT or meta["version"] != VERSION:
            raise ValueError(f"it is {meta['format']!r} version {meta['version']!r}; must be version {VERSION}")
        check_environment(meta["environment"])
        return NetworkPolicy(
            weights=tuple(arrays[f"weight_{layer}"] for layer in layers),
            biases=tuple(arrays[f"bias_{layer}"] for layer in layers),
            activation=meta["activation"],
            environment=meta["environment"],
            origin=meta["origin"],
            **{name: arrays[name] for name in ARRAYS},
        )
    except Exception as error:  # numpy's reader of array headers lets through what Python's own parsers raise.
        raise ValueError(f"{path}: not a sound {FORMAT}: {error}") from error


def check_environment(arguments: object) -> None:
    """Refuse arguments of `gymnasium.make`, as read from a file, that would import anything, or make no worm."""
    given = names("environment", arguments, arguments, "arguments")  # type: ignore[arg-type]
    if not given:
        return
    without_imports("environment", {name: value for name, value in given.items() if name != "id"})
    known = gymnasium.registry.get(str(given.get("id")).removeprefix("lattice_gym:"))
    if known is None or not str(known.entry_point).startswith(OWN_ENTRY):
        raise invalid_value("environment: id", given.get("id"), "must be that of a worm, registered by this package")


def _frozen(name: str, values: npt.ArrayLike, shape: Sequence[int | str] | None = None) -> FloatArray:
    """Read-only array of a shape in double precision."""
    frozen: FloatArray = array(name, values, None if shape is None else tuple(shape), read_only=True)
    return frozen
