"""The environment as training, evaluation and rollouts wrap it."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Mapping
from functools import partial
from multiprocessing import forkserver, resource_tracker
from typing import Any, cast

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.wrappers import RescaleAction
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecCheckNan, VecEnv

from agents.command_line import SIGNALS
from agents.config import InputError

Env = gymnasium.Env[Any, Any]

LEAST_LEAN = 0.05
"""A worm that is bent by less leans no way [deg]."""


def make_env(arguments: Mapping[str, Any]) -> Env:
    """Environment with actions in [-1, 1] and `outcome_errors` in info; raises InputError if it cannot be built."""
    try:
        env = gymnasium.make(**arguments)
    except ValueError as error:
        raise InputError(str(error)) from error
    return Judged(RescaleAction(env, np.float32(-1.0), np.float32(1.0)))


class Judged(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Adds `outcome_errors` to the info of every step."""

    def step(self, action: npt.NDArray[Any]) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take a step of the worm."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        task = cast(Any, self.unwrapped).task
        info["outcome_errors"] = outcome_errors(task.name, task.command, info["outcome"])
        return observation, reward, terminated, truncated, info


def outcome_errors(task: str, command: Mapping[str, float], outcome: Mapping[str, float]) -> dict[str, float]:
    """Outcome measured by its command, so that a mean over episodes with different commands has a meaning.

    bending: bend_deg, and off_azimuth_deg, the angle in [0, 180] between the azimuths of the bend and of the command;
    absent where the worm stands upright. peristalsis: wave_index, and speed and amplitude of the wave over those asked
    for: 1 is exact, 0 no wave, and a speed below 0 is a wave that runs the wrong way. reach: distance [m] and reached;
    reach_time [s] is absent where the target was not. crawl: speed [body heights a minute], drift_deg, and
    cost_of_transport, absent where there was no way along the command. Other tasks command nothing: their outcome as it
    is.
    """
    if task == "bending":
        bend = float(np.degrees(outcome["bend_angle"]))
        turn = float(np.degrees(outcome["bend_direction"] - command["azimuth"]))
        off = abs((turn + 180.0) % 360.0 - 180.0)
        return {"bend_deg": bend} | ({"off_azimuth_deg": off} if bend >= LEAST_LEAN else {})
    if task == "peristalsis":
        velocity = outcome["wave_direction"] * outcome["wave_speed"]
        return {
            "wave_index": outcome["wave_index"],
            "speed_over_asked": velocity / command["speed"],
            "amplitude_over_asked": outcome["wave_amplitude"] / command["amplitude"],
        }
    if task == "reach" and not outcome["reached"]:
        return {name: value for name, value in outcome.items() if name != "reach_time"}
    if task == "crawl":
        cost = {name: value for name, value in outcome.items() if name == "cost_of_transport" and value > 0.0}
        return {"speed": outcome["speed"], "drift_deg": float(np.degrees(outcome["drift"]))} | cost
    return dict(outcome)


def make_vector_env(arguments: Mapping[str, Any], n_envs: int) -> VecEnv:
    """Worms side by side, each in its own process if more than one; NaN or infinity on the way raises ValueError."""
    worms: list[Callable[[], Env]] = [partial(_monitored, arguments)] * n_envs
    if n_envs == 1:
        return VecCheckNan(DummyVecEnv(worms), raise_exception=True)
    _compile(arguments)
    _start_server()
    return VecCheckNan(WormProcesses(worms), raise_exception=True)


class WormProcesses(SubprocVecEnv):
    """Worms in processes of their own, which leave signals to the learner and therefore end with it by force."""

    def __init__(self, worms: list[Callable[[], Env]]) -> None:
        try:
            super().__init__(worms)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the processes, whatever they are doing: there is nothing in them to save."""
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.join()
        for remote in self.remotes:
            remote.close()
        self.closed = True


def _start_server() -> None:
    """Start what the processes are forked from, deaf to the signals that end the learner, which then ends them.

    It inherits the mask, so there is no moment at which ctrl-C could reach them and have them print tracebacks.
    """
    multiprocessing.set_forkserver_preload([__name__])  # imported once, not once a process
    resource_tracker.ensure_running()  # which would lift the mask
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)


def _compile(arguments: Mapping[str, Any]) -> None:
    """Take one step, so that processes started later find compiled code on the disk instead of each compiling it."""
    env = make_env(arguments)
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape or (), dtype=np.float32))
    env.close()


def _monitored(arguments: Mapping[str, Any]) -> Env:
    """One worm whose episodes are summed up."""
    return Monitor(make_env(arguments))
