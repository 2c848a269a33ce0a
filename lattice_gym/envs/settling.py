"""Coming to rest: the state in which episodes of a task that settles start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lattice_gym.engines.simulation import simulate
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.stable_step import default_dt
from lattice_gym.physics.state import Motion, RodState
from lattice_gym.tasks.base import Task

SETTLING_SPAN, LONGEST_SETTLING = 0.5, 30.0
"""How often, while worm and ball settle, it is looked whether they are at rest; when that ends at the latest [s]."""
SETTLING_DRAG = 0.05
"""Largest drag of a medium while worm and ball settle [N s/m^2]: more holds up a worm that rolls over, and where all
comes to rest it is the same."""
QUIET, AT_REST = 1e-4, 1e-3
"""Largest speed of a node or ball at which settling ends, and at which an episode may start at all [heights / s].

A crawler that is damped as much as other tasks' worms is, comes down to the second only. In the tasks' own worlds the
first is reached, and doing nothing then earns less than 0.0001 a step."""


def settled(task: Task, model: RodModel) -> RodState:
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
    # Slack muscles damp nothing, whatever their law, and need no shorter step for it.
    step = default_dt(replace(body, hill=None), SETTLING_SPAN, design.max_tension)
    run, start, now, speed = simulate("fused", body, step), state, state, np.inf
    for _ in range(round(LONGEST_SETTLING / SETTLING_SPAN)):
        health, before = run.advance(np.zeros(model.n_muscle), round(SETTLING_SPAN / step)), now
        if not health.ok:
            raise ValueError(f"world: worm and ball do not come to rest in it: {health}")
        now = run.state
        speed = _speed(before, now) / design.height
        start = replace(state, position=now.position, directors=now.directors, bolus_position=now.bolus_position)
        if speed <= QUIET or task.over(Motion.of(start))[0]:
            break
    if task.over(Motion.of(start))[0]:
        raise ValueError(f"world: {task.name} is over before it starts: while worm and ball come to rest in it")
    if not speed <= AT_REST:
        raise ValueError(
            f"world: worm and ball do not come to rest in it: after {LONGEST_SETTLING:g} s their largest speed is "
            f"{speed:.3g} heights a second; must be at most {AT_REST:g}"
        )
    return start


def _speed(before: RodState, now: RodState) -> float:
    """Largest speed of a node or ball [m/s]: that of now or the mean since a state SETTLING_SPAN ago."""
    nodes = now.velocity, (now.position - before.position) / SETTLING_SPAN
    balls = now.bolus_velocity, (now.bolus_position - before.bolus_position) / SETTLING_SPAN
    return max(float(np.linalg.norm(part, axis=1).max(initial=0.0)) for part in (*nodes, *balls))
