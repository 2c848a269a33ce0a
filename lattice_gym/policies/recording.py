"""Episodes of a policy as trajectories and films."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from lattice_gym.policies.base import EVALUATION_SEED, EnvLike, Policy, opened, play
from lattice_gym.recording.trajectory import Recorder, Trajectory


def record(
    policy: Policy,
    env: EnvLike,
    seed: int = EVALUATION_SEED,
    progress: Callable[[str], object] = lambda _line: None,
) -> Trajectory:
    """Play one seeded episode; the first frame is its start, each further one the end of a control step.

    Arguments are those of `evaluate`, errors too. What is recorded of muscles is their activation, not the action. An
    episode that diverged ends with its last sound state again, at the time of the step that failed, and its status.
    """
    total = 0.0
    with opened(env) as (made, worm):
        recorder = Recorder(worm.design, worm.layout, worm.task.name, worm.world)
        for number, step in enumerate(play(policy, made, seed)):
            progress(f"recording: step {number}")
            total += step.reward
            state, failure = worm.state, "" if worm.worms.health().ok else worm.worms.status()
            parts = (f"return {total:.2f}", worm.task.caption(state), failure)
            line = "   ".join(part for part in parts if part)
            recorder.append(worm.time, state.position, worm.activation, step.reward, line, state.ball_position)
        return recorder.build(worm.task.markers(0))


def film(
    policy: Policy, env: EnvLike, path: str | os.PathLike[str], seed: int = EVALUATION_SEED, **options: Any
) -> Trajectory:
    """Record an episode, write its video, an .mp4 or an animated .gif, and return it.

    Arguments are those of `record`, options those of `rendering.video.render_video`. Needs the extra "video".
    """
    from lattice_gym.rendering.video import render_video  # with a graphics library, which nothing else here needs

    trajectory = record(policy, env, seed)
    render_video(trajectory, path, **options)
    return trajectory
