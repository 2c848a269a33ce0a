"""Coming to rest: the state in which episodes of a task that settles start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lattice_gym.body.muscles import MuscleLayout
from lattice_gym.engines.health import describe
from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.critical_step import default_dt
from lattice_gym.physics.state import Motion, RodState
from lattice_gym.tasks.base import Task

SETTLING_INTERVAL, MAX_SETTLING_TIME = 0.5, 30.0
"""Time between two checks whether worm and ball are at rest, and the longest time that they may take [s]."""
SETTLING_DRAG = 0.05
"""Largest drag of a medium while worm and ball settle [N s/m^2]: more slows a worm that rolls over, and the state of
rest does not depend on it."""
SETTLED_SPEED, MAX_START_SPEED = 1e-4, 1e-3
"""Largest speed of a node or ball at which settling ends, and at which an episode may start at all [body lengths / s].

A crawling worm with the damping of other tasks' worms only gets below the second. In the tasks' own worlds speeds fall
below the first, and doing nothing then earns less than 0.0001 a step."""


def settle(task: Task, model: RodModel, layout: MuscleLayout) -> RodState:
    """State in which an episode starts, at rest: that of the model, or what it settles into where the task asks for it.

    Raises
    ------
    ValueError
        Worm and ball diverge, do not come to rest in time, or the task is over before they do.
    """
    state, design = model.rest_state(), task.lattice.design
    if not task.settles:
        return state
    body = replace(model, medium_drag=min(model.medium_drag, SETTLING_DRAG))
    # Muscles without tension have no damping by Hill's law, and need no shorter step for it.
    step = default_dt(replace(body, hill=None), SETTLING_INTERVAL, design.max_tension)
    run, start, now, speed = simulate("fused", body, step), state, state, np.inf
    for _ in range(round(MAX_SETTLING_TIME / SETTLING_INTERVAL)):
        health, before = run.advance(np.zeros(model.n_muscle), round(SETTLING_INTERVAL / step)), now
        if not health.ok:
            raise ValueError(
                f"world: worm and ball do not come to rest in it: {describe(health, task.lattice, layout)}"
            )
        now = run.state
        speed = _speed(before, now) / design.height
        start = replace(state, position=now.position, directors=now.directors, ball_position=now.ball_position)
        if speed <= SETTLED_SPEED or task.terminated(Motion.of(start))[0]:
            break
    if task.terminated(Motion.of(start))[0]:
        raise ValueError(f"world: {task.name} is over before it starts: while worm and ball come to rest in it")
    if not speed <= MAX_START_SPEED:
        raise ValueError(
            f"world: worm and ball do not come to rest in it: after {MAX_SETTLING_TIME:g} s their largest speed is "
            f"{speed:.3g} body lengths a second; must be at most {MAX_START_SPEED:g}"
        )
    return start


def _speed(before: RodState, now: RodState) -> float:
    """Largest speed of a node or ball [m/s]: that of now or the mean since a state SETTLING_INTERVAL ago."""
    nodes = now.velocity, (now.position - before.position) / SETTLING_INTERVAL
    balls = now.ball_velocity, (now.ball_position - before.ball_position) / SETTLING_INTERVAL
    return max(float(np.linalg.norm(part, axis=1).max(initial=0.0)) for part in (*nodes, *balls))
