"""What `info` tells of worms at the start of an episode and after every step, in numbers; their status as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import VectorEnv

from lattice_gym.checks import invalid_value
from lattice_gym.engines.health import Health, Status, describe
from lattice_gym.envs.scene import Scene

if TYPE_CHECKING:
    from lattice_gym.envs.core import Worms

STATUS = ("status", "rod", "element", "joint")
"""Names of the whole numbers that tell how a step went: a code of `Status`, and where, -1 for nowhere."""
_SOUND = (int(Status.OK), -1, -1, -1)
"""Those numbers where nothing failed."""
_SOUND_COLUMN = np.array(_SOUND)[:, None]


def describe_status(
    info: Mapping[str, Any], env: gymnasium.Env[Any, Any] | VectorEnv[Any, Any, Any] | None = None, worm: int = 0
) -> str:
    """Return "ok", or what went wrong in a step and where, as text.

    Parameters
    ----------
    info
        As a step or a reset gives it, be it of one environment or of a vector environment.
    env
        Either, of the same worms, wrapped or not: then muscles and rods are named. None: they have the numbers of info.
    worm
        Row in the infos of a vector environment; negative ones count from the last.

    Raises
    ------
    ValueError
        What is no such info, or no environment of worms.
    IndexError
        There is no such worm.

    """
    try:
        status, *place = (int(np.ravel(info[name])[worm]) for name in STATUS)
        health = Health(Status(status), *place)
    except (KeyError, TypeError, ValueError):
        must = f"must be what reset or step return, with whole numbers {', '.join(STATUS)}"
        raise invalid_value("info", info, must) from None
    if env is None:
        return str(health)
    scene = getattr(getattr(env, "unwrapped", None), "scene", None)
    if not isinstance(scene, Scene):
        raise invalid_value("env", env, "must be an environment of worms")
    return describe(health, scene.lattice, scene.layout)


def worm_info(worms: Worms, worm: int = 0) -> dict[str, Any]:
    """Return what is told of a worm at the start and after every step alike, apart from reward, outcome and counts."""
    health = worms.health(worm)
    info: dict[str, Any] = {"command": worms.task.command_of(worm)}
    info["status"], info["rod"], info["element"], info["joint"] = _SOUND if health.ok else _numbers(health)
    if worms.factors:
        info["factors"] = {name: _row(values, worm) for name, values in worms.factors.items()}
    if worms.scene.adaptation is not None:
        info["strength"] = worms.strength[worm].copy()
    return info


def worm_infos(worms: Worms) -> dict[str, Any]:
    """Return `worm_info` of all worms: arrays with a row a worm."""
    infos: dict[str, Any] = {"command": {name: values.copy() for name, values in worms.task.commanded.items()}}
    numbers = _SOUND_COLUMN.repeat(worms.n_worm, axis=1)
    for worm in worms.failed.nonzero()[0].tolist():
        numbers[:, worm] = _numbers(worms.health(worm))
    infos["status"], infos["rod"], infos["element"], infos["joint"] = numbers
    if worms.factors:
        infos["factors"] = {name: values.copy() for name, values in worms.factors.items()}
    if worms.scene.adaptation is not None:
        infos["strength"] = worms.strength.copy()
    return infos


def _numbers(health: Health) -> tuple[int, int, int, int]:
    return int(health.status), health.rod, health.element, health.joint


def _row(values: npt.NDArray[Any], worm: int) -> Any:
    return values.item(worm) if values.ndim == 1 else values[worm].copy()
