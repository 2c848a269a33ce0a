"""What episodes achieved, judged by what was commanded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import gymnasium
import numpy as np
import numpy.typing as npt

LEAST_LEAN = 0.05
"""A worm that is bent by less leans no way [deg]."""


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
