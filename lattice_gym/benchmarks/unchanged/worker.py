"""What runs inside a checkout, old or new: answers on stdout, a line of JSON for each line of JSON on stdin.

It is run by its path, with the checkout's package first on Python's path, and so imports nothing of the benchmarks.
What older commits say in other words is in the two adapters, `_advance_one` and `_advance_many`.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

FIELDS = ("position", "velocity", "directors", "omega", "ball_position", "ball_velocity", "ball_omega")
"""Of the state."""
TIMED_ID, DT, TENSION = "LatticeWormExtension-v0", 1e-4, 0.5
"""Environment whose worm is timed, its step [s] and the tension in every muscle [N]: the benchmark scene."""
N_STEPS, N_WORM = 2000, 16


def ids() -> list[str]:
    """Every registered environment."""
    return sorted(name for name in gymnasium.registry if name.startswith("LatticeWorm"))


def record(env_id: str, actions: str, n_steps: int) -> list[dict[str, str]]:
    """Digest of every array, by name, after reset and after each control step of an episode of at most `n_steps`."""
    env = gymnasium.make(env_id)
    rng = np.random.default_rng(3)
    shape = env.action_space.shape or ()
    observation, _ = env.reset(seed=7)
    steps = [_digests(env, observation, 0.0)]
    for _ in range(n_steps):
        action = rng.random(shape, np.float32) if actions == "random" else np.zeros(shape, np.float32)
        observation, reward, terminated, truncated, _ = env.step(action)
        steps.append(_digests(env, observation, float(reward)))
        if terminated or truncated:
            break
    env.close()
    return steps


def _digests(env: gymnasium.Env[Any, Any], observation: Any, reward: float) -> dict[str, str]:
    parts = observation if isinstance(observation, dict) else {"": observation}
    arrays = {f"observation {name}".strip(): part for name, part in parts.items()} | {"reward": np.float64(reward)}
    state: Any = env.unwrapped.state  # type: ignore[attr-defined]
    for name in FIELDS:
        own = name if hasattr(state, name) else name.replace("ball", "bolus")  # its name in older commits
        if hasattr(state, own):
            arrays[f"state.{name}"] = getattr(state, own)
    return {name: hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest() for name, array in arrays.items()}


def _advance_one(model: Any) -> Callable[[int], object]:
    """Take steps with one worm on one thread."""
    pull = np.full(model.n_muscle, TENSION)
    try:
        engine = import_module("lattice_gym.engines.simulation").simulate("fused", model, DT)
    except ImportError:
        try:
            make_engine = import_module("lattice_gym.engines.registry").make_engine
        except ImportError:
            make_engine = import_module("lattice_gym.engines").make_engine
        engine = make_engine("fused", model, DT)
    return lambda n_steps: engine.advance(pull, n_steps)


def _advance_many(model: Any) -> Callable[[int], object]:
    """Take steps with `N_WORM` worms on one thread."""
    models, pull = [model] * N_WORM, np.full((N_WORM, model.n_muscle), TENSION)
    try:
        import_module("lattice_gym.engines.simulation")
    except ImportError:
        engine = import_module("lattice_gym.engines.batch").BatchEngine(models, DT, num_threads=1)
    else:
        engine = import_module("lattice_gym.engines.registry").make_engine("fused", models, DT, num_threads=1)
    return lambda n_steps: engine.advance(pull, n_steps)


@cache
def timer(what: str) -> Callable[[], float]:
    """Find the seconds of a step (of one worm) or of a control step (of the environment); built once.

    Processor time, as one thread works, so that what else runs on the machine is no part of it.
    """
    env: Any = gymnasium.make(TIMED_ID)
    if what == "env":
        action, n_call = np.ones(env.action_space.shape, np.float32), 30

        def act() -> None:
            for _ in range(n_call):
                env.step(action)

        return lambda: (env.reset(seed=0), _seconds(act) / n_call)[1]
    n_worm, make = (1, _advance_one) if what == "one" else (N_WORM, _advance_many)
    advance, n_steps = make(env.unwrapped.model), N_STEPS // n_worm
    return lambda: _seconds(lambda: advance(n_steps)) / (n_steps * n_worm)


def _seconds(action: Callable[[], object]) -> float:
    start = time.process_time()
    action()
    return time.process_time() - start


def main() -> None:
    """Answer until stdin ends."""
    package = import_module("lattice_gym")
    found = Path(package.__file__ or "").resolve().parents[1]
    if found != Path.cwd().resolve():
        raise RuntimeError(f"lattice_gym was imported from {found}, not from the checkout")
    answers: dict[str, Callable[..., Any]] = {"ids": ids, "record": record, "time": lambda what: timer(what)()}
    for line in sys.stdin:
        name, *arguments = json.loads(line)
        print(json.dumps(answers[name](*arguments)), flush=True)


if __name__ == "__main__":
    main()
