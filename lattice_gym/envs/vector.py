"""Worms side by side: the vector environment that `gymnasium.make_vec` gives for every id of this package."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, NoReturn, SupportsIndex

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from lattice_gym.checks import FloatArray, IntArray, choice, invalid_value, is_list, items, optional, whole
from lattice_gym.envs.actions import to_command
from lattice_gym.envs.attributes import SceneAttributes
from lattice_gym.envs.core import Mask, Worms
from lattice_gym.envs.env import METADATA
from lattice_gym.envs.info import worm_infos
from lattice_gym.envs.observation import Observation
from lattice_gym.envs.pictures import RENDER_MODES, Pictures
from lattice_gym.envs.pitfalls import warn_of_pitfalls
from lattice_gym.envs.registration import warn_of_time_limit
from lattice_gym.envs.scene import Scene, takes_scene_arguments

NO_LIMIT = -1
"""What gymnasium calls an episode without a time limit."""


class LatticeWormVectorEnv(SceneAttributes, VectorEnv[Observation, npt.NDArray[np.float32], npt.NDArray[Any]]):
    """Many worms of one kind in one process, in compiled threads; `LatticeWormEnv` says what each of them is.

    To the last bit it gives what `gymnasium.vector.SyncVectorEnv` gives of as many single environments, but for two
    things. `info["outcome"]` is there only for worms whose episode ends with the step (and masked by
    `info["_outcome"]`, as ever), for its waves cost more than all else; `outcome` gives that of all worms at any time.
    And actions must be sound in every row, also in those of worms that are reset in this step.

    Seeds, resets by `options["reset_mask"]`, masks of infos, `final_obs` and `final_info` are as in `SyncVectorEnv`. A
    worm whose physics diverges ends alone; no other changes by it. `render` gives a tuple of pictures, one a worm.
    `autoreset_mode` is an attribute too. It can be neither pickled nor copied.

    Commanded numbers in options are for all worms, a list is one to draw from for each, and a NumPy array, of shape
    (num_envs,), holds one for each.

    Parameters
    ----------
    num_envs
        Number of worms.
    max_episode_steps
        Steps after which an episode is truncated; None and -1, as in `gymnasium.make`: never. Where it is not given,
        `gymnasium.make_vec` gives that of the id. It is the `time_limit` too, unless that is given; a single
        environment must be given it to have the same penalty.
    autoreset_mode
        `gymnasium.vector.AutoresetMode` or its value: when a worm whose episode has ended is reset, at the next step
        (whose action it ignores), at once, or only by `reset`. Of both only the value can be written as JSON.
    num_threads
        Threads that advance worms; None: as many as there are processors for this process.
    arguments
        As of `LatticeWormEnv`; an EnvSpec survives JSON as there.

    Raises
    ------
    ValueError
        An argument that cannot be used; it is named.
    gymnasium.error.ResetNeeded
        A step before the first reset, or of a worm that has ended and does not reset itself.
    """

    closed = True
    """Whether there is nothing to free: so for one whose arguments were refused."""
    _goals_apart: ClassVar[bool] = False
    """Whether goals are observed apart."""
    _spec: EnvSpec | None = None

    @takes_scene_arguments
    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        num_threads: int | None = None,
        *,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        self.num_envs = whole("num_envs", num_envs, 1)
        unlimited = isinstance(max_episode_steps, int | np.integer) and max_episode_steps == NO_LIMIT
        self._limit = None if unlimited else optional(whole, "max_episode_steps", max_episode_steps, 1)
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            modes = ", ".join(repr(mode.value) for mode in AutoresetMode)
            raise invalid_value("autoreset_mode", autoreset_mode, f"must be one of {modes}") from None
        self.render_mode = optional(choice, "render_mode", render_mode, RENDER_MODES)
        arguments["goals_apart"] = self._goals_apart
        arguments.setdefault("time_limit", self._limit)
        self.scene = Scene(**arguments)
        warn_of_pitfalls(self.scene, arguments)
        self.worms = Worms(self.scene, self.num_envs, num_threads=num_threads)
        self.metadata = {**METADATA, "render_fps": 1.0 / self.scene.control_dt, "autoreset_mode": self.autoreset_mode}
        self.single_action_space = self.scene.action_space
        self.single_observation_space = self.worms.observer.space
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._pictures = Pictures(self.worms)
        self._random = [seeding.np_random(None) for _ in range(self.num_envs)]
        self._observation: Observation = None
        self._ended = np.zeros(self.num_envs, dtype=np.bool_)
        self.closed = False

    @property
    def spec(self) -> EnvSpec | None:
        """Specification that `gymnasium.make_vec` made it of, which gives it last; None without."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = spec
        if self._limit:
            warn_of_time_limit(spec, self.scene.task_class, self._limit)

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Generator of every worm."""
        return tuple(generator for generator, _ in self._random)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of every worm's generator."""
        return tuple(seed for _, seed in self._random)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode of every worm, or of those in `options["reset_mask"]`.

        Parameters
        ----------
        seed
            Of the first worm, and one more for each after it; or a list, one a worm; None goes on drawing.
        options
            Commanded numbers by name for these episodes, and `reset_mask`: bool, shape (num_envs,).
        """
        seeds, (mask, given) = self._seeds(seed), self._options(options)
        if self._observation is None and not mask.all():
            raise gymnasium.error.ResetNeeded("reset() must be called without a reset_mask first")
        for worm in _worms(mask):
            self.worms.task.check(given[worm])
        self.worms.engine.require_idle()
        for worm in _worms(mask):
            if seeds[worm] is not None:
                self._random[worm] = seeding.np_random(seeds[worm])
            self._begin(worm, given[worm])
        self._ended = self._ended & ~mask
        observation, n_beyond = self.worms.observe()
        self._observation = observation if mask.all() else _merge(mask, observation, self._observation)
        terms = {name: np.zeros(self.num_envs) for name in self.worms.reward_names}
        infos = self._infos(terms, np.zeros(self.num_envs, dtype=np.int64), n_beyond)
        return _copy(self._observation), _mask_infos(infos, mask)

    def step(self, actions: npt.ArrayLike) -> tuple[Observation, FloatArray, Mask, Mask, dict[str, Any]]:
        """Advance every worm by `control_dt`, but for those that are reset instead."""
        if self._observation is None:
            raise gymnasium.error.ResetNeeded("reset() must be called first")
        command, n_clipped = to_command(actions, (self.num_envs, self.scene.n_group), self.scene.action_range)
        if self.autoreset_mode is AutoresetMode.DISABLED and self._ended.any():
            worms = _worms(self._ended)
            raise gymnasium.error.ResetNeeded(f"worms {worms} have ended and must be reset first")
        live = ~self._ended
        result = self.worms.step(command, live)
        truncated: Mask = live & (self.worms.n_step >= self._limit) if self._limit else np.zeros_like(live)
        ended = result.terminated | truncated
        outcome = self._outcome_of(ended.nonzero()[0])
        for worm in _worms(~live):
            self._begin(worm)
            n_clipped[worm] = 0
        observation, n_beyond = self.worms.observe()
        told, others = self._infos(result.terms, n_clipped, n_beyond), _mask_infos({"outcome": outcome}, ended)
        if self.autoreset_mode is not AutoresetMode.SAME_STEP:
            self._ended = ended
        elif ended.any():
            others = self._final(observation, ended) | {"final_info": _mask_infos(told, ended) | others}
            for worm in _worms(ended):
                self._begin(worm)
            observation, n_beyond = self.worms.observe()
            terms = {name: np.where(ended, 0.0, values) for name, values in result.terms.items()}
            told = self._infos(terms, np.where(ended, 0, n_clipped), n_beyond)
        infos = _masked(told, np.ones_like(live), whole=True) | others
        self._observation = observation
        return _copy(observation), result.reward, result.terminated, truncated, infos

    @property
    def activation(self) -> FloatArray:
        """Activation of every active muscle now, shape (num_envs, n_muscle), in [0, 1]."""
        return self.worms.activation

    @property
    def strength(self) -> FloatArray:
        """Strength of every active muscle now, over that of the design, shape (num_envs, n_muscle)."""
        return self.worms.strength.copy()

    @property
    def time(self) -> FloatArray:
        """Time since each episode began [s], at the end of its last control step, shape (num_envs,)."""
        return self.worms.time

    def outcome(self) -> dict[str, FloatArray]:
        """Return what the motion of every worm came to by now, shape (num_envs,) each; see `LatticeWormEnv`."""
        return self.worms.outcome()

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """Pictures of the worms now, shape (480, 640, 3) each, as of `LatticeWormEnv.render`; None without a mode."""
        return None if self.render_mode is None else tuple(map(self._pictures.draw, range(self.num_envs)))

    def close_extras(self, **_: Any) -> None:
        """Free threads and the renderer."""
        self._pictures.close()
        self.worms.close()

    def __reduce_ex__(self, _: SupportsIndex) -> NoReturn:
        """Refuse to be pickled or copied: the parts of the physics share arrays, which a copy would not."""
        raise TypeError(f"{type(self).__name__}: can be neither pickled nor copied")

    def _begin(self, worm: int, options: Mapping[str, object] | None = None) -> None:
        """Start an episode of a worm."""
        self.worms.begin(worm, self._random[worm][0], options)

    def _infos(self, terms: dict[str, FloatArray], n_clipped: IntArray, n_beyond: IntArray) -> dict[str, Any]:
        """Info of the last step, or of the start, of every worm."""
        infos = worm_infos(self.worms)
        infos["reward_terms"], infos["clipped_actions"], infos["clipped_observations"] = terms, n_clipped, n_beyond
        return infos

    def _outcome_of(self, worms: IntArray) -> dict[str, FloatArray]:
        """Outcome of some worms, by name and with a row for every worm; nothing at all without any."""
        if not worms.size:
            return {}
        outcome = {}
        for name, values in self.worms.outcome(worms).items():
            outcome[name] = np.zeros(self.num_envs)
            outcome[name][worms] = values
        return outcome

    def _final(self, observation: Observation, ended: Mask) -> dict[str, Any]:
        """Last observations of episodes that have ended."""
        final = np.full(self.num_envs, None, dtype=object)
        for worm in _worms(ended):
            final[worm] = (
                {name: part[worm] for name, part in observation.items()}
                if isinstance(observation, dict)
                else observation[worm]
            )
        return {"final_obs": final, "_final_obs": ended.copy(), "_final_info": ended.copy()}

    def _seeds(self, seed: object) -> list[int | None]:
        """Seed of every worm."""
        if is_list(seed):
            one_each = partial(optional, partial(whole, low=0))
            return list(items("seed", seed, one_each, self.num_envs, "seeds, one a worm"))
        first = optional(whole, "seed", seed, 0)
        return [None if first is None else first + worm for worm in range(self.num_envs)]

    def _options(self, options: dict[str, Any] | None) -> tuple[Mask, list[dict[str, Any] | None]]:
        """Worms to reset, and the options of every worm."""
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if not isinstance(options, Mapping):
            return mask, [options] * self.num_envs
        given = dict(options)
        if "reset_mask" in given:
            mask = given.pop("reset_mask")
            fits = isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == (self.num_envs,)
            if not (fits and mask.any()):
                must = f"must be an array of bool of shape ({self.num_envs},), with at least one worm in it"
                raise invalid_value("options['reset_mask']", mask, must)
        each = [name for name, value in given.items() if isinstance(value, np.ndarray) and value.ndim > 0]
        for name in each:
            if given[name].shape != (self.num_envs,):
                raise ValueError(
                    f"options[{name!r}]: an array must hold one number a worm, shape ({self.num_envs},), got "
                    f"{given[name].shape}"
                )
        own = {name: given[name].tolist() for name in each}
        return mask, [given | {name: own[name][worm] for name in each} for worm in range(self.num_envs)]


def _worms(mask: Mask) -> list[int]:
    """Return the indices of some worms."""
    worms: list[int] = mask.nonzero()[0].tolist()
    return worms


def _mask_infos(values: Mapping[str, Any], rows: Mask) -> dict[str, Any]:
    """Infos of some worms as gymnasium has them: arrays with a mask each; nothing where there are none."""
    return _masked(values, rows, bool(rows.all())) if rows.any() else {}


def _masked(values: Mapping[str, Any], rows: Mask, whole: bool) -> dict[str, Any]:
    """Infos of some worms, of all of them where they are the whole."""
    infos: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            infos[name] = _masked(value, rows, whole)
        elif whole:
            infos[name] = value
        else:
            infos[name] = np.zeros_like(value) if value.dtype != object else np.full(value.shape, None, dtype=object)
            infos[name][rows] = value[rows]
        infos[f"_{name}"] = rows.copy()
    return infos


def _merge(rows: Mask, new: Observation, old: Observation) -> Observation:
    """Observations, new ones in some rows."""
    if isinstance(new, dict):
        return {name: _merge(rows, part, old[name]) for name, part in new.items()}
    return np.where(rows[:, None], new, old)


def _copy(observation: Observation) -> Observation:
    return (
        {name: part.copy() for name, part in observation.items()}
        if isinstance(observation, dict)
        else observation.copy()
    )
