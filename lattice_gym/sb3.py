"""Worms of a vector environment, as Stable-Baselines3 takes them; needs the extra "sb3".

The one module of this package that imports Stable-Baselines3, and nothing else here imports it.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers.utils import rescale_box

from lattice_gym.checks import invalid_value, is_list
from lattice_gym.envs.vector import LatticeWormVectorEnv

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn
except ImportError as error:
    raise ImportError(f'lattice_gym.sb3 needs {error.name}: pip install "stable-baselines3>=2.7"') from error


class WormVecEnv(VecEnv):
    """Stable-Baselines3's VecEnv of n worms that step together: actions in [-1, 1], episodes summed up and judged.

    Actions lie there whatever the `action_range` of the worms.

    It gives what DummyVecEnv gives of n single worms with rescaled actions, each in a Monitor, to the last bit, except
    that the info of a worm in mid-episode is empty. That of an episode's last step holds `outcome_errors` too, see
    `Task.errors`. Only where goals are observed do others hold `reward_terms`, by which `compute_reward` pays:
    hindsight replay needs `copy_info_dict=True`, as for a single worm.

    Attributes and methods are those of the bare vector environment, which all worms share.

    Parameters
    ----------
    envs
        A `LatticeWormVectorEnv` with `AutoresetMode.SAME_STEP`, or a wrapper of it.

    Raises
    ------
    ValueError
        Something else than that; actions of another shape than (n, n_action); options that are neither a dict
        for all worms nor a list of n dicts; an attribute to set for some worms, as all share it.
    """

    def __init__(self, envs: VectorEnv[Any, Any, Any]) -> None:
        bare = envs.unwrapped if isinstance(envs, VectorEnv) else None
        if not isinstance(bare, LatticeWormVectorEnv):
            raise invalid_value("envs", envs, "must be a LatticeWormVectorEnv, or a wrapper of one")
        if (mode := envs.metadata.get("autoreset_mode")) is not AutoresetMode.SAME_STEP:
            raise ValueError(f"envs: autoreset_mode must be AutoresetMode.SAME_STEP, got {mode}")
        self.envs: Any = envs
        assert isinstance(envs.single_action_space, spaces.Box)
        actions, _, self._own_actions = rescale_box(envs.single_action_space, np.float32(-1.0), np.float32(1.0))
        super().__init__(envs.num_envs, envs.single_observation_space, actions)
        self.metadata, self.spec = dict(envs.metadata), envs.spec
        self._task = bare.scene.task_class
        self._has_goals = isinstance(envs.single_observation_space, spaces.Dict)
        self._returns = np.zeros(self.num_envs)
        self._lengths = np.zeros(self.num_envs, dtype=np.int64)
        self._began = time.time()

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Give the next reset options: the same for all worms, or one dict for each."""
        each = list(options) if is_list(options) else [options or {}] * self.num_envs
        if len(each) != self.num_envs or not all(isinstance(one, dict) for one in each):
            raise ValueError(f"options: must be one dict, or a list of one for each of {self.num_envs} worms")
        super().set_options(options)

    def reset(self) -> VecEnvObs:
        """Start an episode of every worm, with the seeds and options given for it since the last one."""
        seeds, options, worms = self._seeds, self._options, range(self.num_envs)
        alike, began = all(one == options[0] for one in options), bool(self.reset_infos[0])
        if alike or not began:  # the first reset takes all worms
            observations, infos = self.envs.reset(seed=seeds, options=options[0] if alike else None)
            self.reset_infos = [_of_worm(infos, worm) for worm in worms]
        for worm in () if alike else worms:  # a vector environment takes one dict at a time
            only = {"reset_mask": np.arange(self.num_envs) == worm}
            observations, infos = self.envs.reset(seed=seeds, options=options[worm] | only)
            self.reset_infos[worm] = _of_worm(infos, worm)
        self._returns[:], self._lengths[:] = 0.0, 0
        self._reset_seeds()
        self._reset_options()
        return observations  # type: ignore[no-any-return]

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Take the actions of the next step, in [-1, 1], shape (n, n_action)."""
        if np.shape(actions) != (shape := (self.num_envs, *(self.action_space.shape or ()))):
            raise ValueError(f"actions: shape must be {shape}, got {np.shape(actions)}")
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step every worm; one whose episode ended starts the next at once."""
        observations, rewards, terminated, truncated, infos = self.envs.step(self._own_actions(self._actions))
        dones = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        step_info: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for worm in np.flatnonzero(~dones).tolist() if self._has_goals else ():
            step_info[worm]["reward_terms"] = _of_worm(infos["reward_terms"], worm)
        for worm in np.flatnonzero(dones).tolist():
            step_info[worm] = self._ended(worm, infos) | {"TimeLimit.truncated": not terminated[worm]}
        return observations, rewards.astype(np.float32), dones, step_info

    def _ended(self, worm: int, infos: Mapping[str, Any]) -> dict[str, Any]:
        """Info of the episode's last step, with its sums and its outcome by what was commanded."""
        info = _of_worm(infos["final_info"], worm)
        info["outcome_errors"] = self._task.errors(info["outcome"], self.reset_infos[worm]["command"])
        seconds = round(time.time() - self._began, 6)
        info["episode"] = {"r": round(float(self._returns[worm]), 6), "l": int(self._lengths[worm]), "t": seconds}
        info["terminal_observation"] = infos["final_obs"][worm]
        self._returns[worm], self._lengths[worm] = 0.0, 0
        started = {name: values for name, values in infos.items() if name not in ("final_info", "final_obs")}
        self.reset_infos[worm] = _of_worm(started, worm)
        return info

    def close(self) -> None:
        """Close the worms."""
        self.envs.close()

    def get_images(self) -> Sequence[npt.NDArray[np.uint8] | None]:
        """Picture of each worm, shape (height, width, 3); None without a render mode."""
        if self.render_mode is None:
            return [None] * self.num_envs
        return list(self.envs.render())

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Attribute of each worm."""
        return [getattr(self.envs.unwrapped, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Give an attribute of all worms this value."""
        if len(set(self._get_indices(indices))) < self.num_envs:
            raise invalid_value("indices", indices, f"must be None, as all worms share {attr_name}")
        setattr(self.envs.unwrapped, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Return what a method of each worm returns."""
        method = getattr(self.envs.unwrapped, method_name)
        return [method(*method_args, **method_kwargs) for _ in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Whether each worm is in such a wrapper: only in a Monitor, as whose its episodes are summed up."""
        return [issubclass(Monitor, wrapper_class) for _ in self._get_indices(indices)]


def _of_worm(infos: Mapping[str, Any], worm: int) -> dict[str, Any]:
    """Info of one worm out of arrays over all of them: what its masks, `_name`, say that it has."""
    info: dict[str, Any] = {}
    for name, values in infos.items():
        if not name.startswith("_") and infos[f"_{name}"][worm]:
            if isinstance(values, Mapping):
                info[name] = _of_worm(values, worm)
            else:
                info[name] = values[worm] if values.ndim > 1 else values.item(worm)
    return info
