"""Worms side by side: one control step from commands to reward terms, shared by single and vector environments."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray, IntArray, array, names
from lattice_gym.engines.health import Health, describe
from lattice_gym.engines.registry import make_engine
from lattice_gym.envs.measures import Measures
from lattice_gym.envs.observation import Observation, Observer
from lattice_gym.envs.randomisation import apply_factors, tension_factor
from lattice_gym.envs.scene import Scene
from lattice_gym.physics.laws.activation import ACTIVATIONS
from lattice_gym.physics.measures import muscle_strain
from lattice_gym.physics.state import Motion, RodState
from lattice_gym.tasks.base import DIVERGENCE, EFFORT

Mask = npt.NDArray[np.bool_]
"""One bool a worm, shape (n_worm,)."""

Scalar = TypeVar("Scalar", bound=np.generic)

SOUND = Health()
"""That of a step in which nothing failed."""


class Step(NamedTuple):
    """Result of a control step."""

    terms: dict[str, FloatArray]
    """Reward terms by name, in order, shape (n_worm,) each."""
    reward: FloatArray
    """Their sum, shape (n_worm,)."""
    terminated: Mask
    """Of which worms the episode has ended with this step: the task is over, or the physics failed."""


class Worms:
    """One or several worms of a scene, whose episodes begin and end apart but which step together.

    Each moves to the last bit as it would alone. Everything public may be read at any time and changes nothing.

    Parameters
    ----------
    scene
        What they have in common.
    n_worm
        Their number.
    keep_state
        Keep a copy of the state at the end of every sound step, to which a worm returns whose physics fails. Otherwise
        such a worm has no sound state until it begins anew; its motion is that of its last sound moment either way.
    num_threads
        Threads that advance them; None: as many as there are cores for this process.

    Attributes
    ----------
    scene : Scene
        What they have in common.
    n_worm : int
        Their number.
    task : Task
        What is asked of them, with commands and memory of every worm.
    motion : Motion
        Positions and velocities of nodes and balls, as of each worm's last sound moment. Read-only arrays that change
        with every step: copy what is to be kept.
    observer : Observer
        What is observed: terms, their slices, and the space.
    engine : Engine
        What advances them.

    """

    def __init__(
        self, scene: Scene, n_worm: int = 1, *, keep_state: bool = False, num_threads: int | None = None
    ) -> None:
        self.scene, self.n_worm = scene, n_worm
        self.task = scene.make_task(n_worm)
        self.task.rest = scene.start
        self._models, self._num_threads = [scene.model] * n_worm, num_threads
        self._start_engine([scene.start] * n_worm)
        self._saved_states = [scene.start] * n_worm if keep_state else None
        self._foreign_law = type(scene.activation_law) not in ACTIVATIONS.values()
        self._activation = self._rest((n_worm, scene.n_group))
        self._previous_action = np.zeros((n_worm, scene.n_group))
        self._n_step, self._sound_time = np.zeros(n_worm, dtype=np.int64), np.zeros(n_worm)
        self._failed = np.zeros(n_worm, dtype=np.bool_)
        n_muscle = len(scene.groups)
        self._strength = None if scene.adaptation is None else scene.adaptation.initial((n_worm, n_muscle))
        self._tension_factor = None if scene.randomisation is None else np.ones((n_worm, n_muscle))
        drawn = () if scene.randomisation is None else scene.randomisation.ranges
        self._factors = {name: np.ones((n_worm, n_muscle) if name == "strength" else n_worm) for name in drawn}
        self.observer = Observer(scene, self.task)
        self._warned, self._warned_of_length = False, False
        self._unchecked = {"terms", "outcome", "remember"}

    @property
    def reward_names(self) -> tuple[str, ...]:
        """Names of the reward terms, in the order of their sum."""
        return (*self.task.rewards, EFFORT, DIVERGENCE)

    @property
    def group_activation(self) -> FloatArray:
        """Activation of every control group, in [0, 1], shape (n_worm, n_group)."""
        return _read_only(self._activation[0])

    @property
    def previous_action(self) -> FloatArray:
        """Commands of the last step, as clipped, 0 at the start of an episode, shape (n_worm, n_group)."""
        return _read_only(self._previous_action)

    @property
    def n_step(self) -> IntArray:
        """Control steps since each episode began, shape (n_worm,), one that failed included."""
        return _read_only(self._n_step)

    @property
    def sound_time(self) -> FloatArray:
        """Time since each episode began of what `motion` shows [s], shape (n_worm,): that of the last sound step."""
        return _read_only(self._sound_time)

    @property
    def failed(self) -> Mask:
        """Whose physics failed in its last step, shape (n_worm,)."""
        return _read_only(self._failed)

    @property
    def activation(self) -> FloatArray:
        """Activation of every active muscle, in [0, 1], shape (n_worm, n_muscle)."""
        activation: FloatArray = self._activation[0].take(self.scene.groups, axis=-1)
        return activation

    @property
    def strength(self) -> FloatArray:
        """Strength by use of every active muscle over the design's, shape (n_worm, n_muscle); 1 without adaptation."""
        if self._strength is None:
            return _read_only(np.ones((self.n_worm, len(self.scene.groups))))
        return _read_only(self._strength.factor)

    @property
    def factors(self) -> Mapping[str, FloatArray]:
        """Factors of `randomise` drawn for each episode, by name, shape (n_worm,); "strength": (n_worm, n_muscle)."""
        return {name: _read_only(values) for name, values in self._factors.items()}

    @property
    def time(self) -> FloatArray:
        """Time since each episode began [s], at the end of its last step, be it one that failed, shape (n_worm,)."""
        return np.asarray(self._n_step * self.scene.control_dt, dtype=np.float64)

    @property
    def measures(self) -> Measures:
        """Named quantities of the motion now."""
        return Measures(self.scene.lattice, self.scene.model, self.motion)

    def state(self, worm: int = 0) -> RodState:
        """Copy the state of a worm: that of its last sound moment where states are kept."""
        return self.engine.state(worm) if self._saved_states is None else self._saved_states[worm].copy()

    def restore(self, state: RodState, worm: int = 0) -> None:
        """Put the body of a worm into another state; a ValueError where it does not fit.

        Commands, activation and what the task remembers stay.
        """
        self.engine.restore(worm, state)
        if self._saved_states is not None:
            self._saved_states[worm] = state.copy()

    def health(self, worm: int = 0) -> Health:
        """How the last step of a worm went, and where it failed."""
        return self.engine.health(worm) if self._failed[worm] else SOUND

    def status(self, worm: int = 0) -> str:
        """Return "ok", or what went wrong in the last step of a worm and where; of several, with the worm's number."""
        scene = self.scene
        return describe(self.health(worm), scene.lattice, scene.layout, worm if self.n_worm > 1 else None)

    def outcome(self, worms: IntArray | None = None) -> dict[str, FloatArray]:
        """Return what the motion of some worms, by default of all, came to by now, shape (n,) each."""
        if worms is None:
            outcome = self.task.outcome(self.motion, np.arange(self.n_worm))
        else:
            outcome = self.task.outcome(self.motion.rows(worms), worms)
        if "outcome" in self._unchecked:
            self._check_rows("outcome", outcome, self.n_worm if worms is None else len(worms))
        return outcome

    def observe(self) -> tuple[Observation, IntArray]:
        """Observations of all worms, and how many numbers of each were clipped, shape (n_worm,)."""
        return self.observer(self)

    def begin(self, worm: int, generator: np.random.Generator, options: Mapping[str, object] | None = None) -> None:
        """Begin an episode of one worm.

        Parameters
        ----------
        worm
            Its row.
        generator
            What is drawn, comes from it.
        options
            Commanded numbers by name; see `Task.begin`, also for the ValueError.
        """
        scene = self.scene
        self.task.begin(generator, options, worm)
        self._activation[:, worm] = self._rest((scene.n_group,))
        self._previous_action[worm] = 0.0
        self._n_step[worm], self._sound_time[worm], self._failed[worm] = 0, 0.0, False
        if scene.randomisation is not None and self._tension_factor is not None:
            factors = scene.randomisation.draw(generator, len(scene.groups))
            self._tension_factor[worm] = tension_factor(factors)
            self._models[worm] = apply_factors(scene.model, factors)
            self.engine.replace(worm, self._models[worm])
            for name, values in self._factors.items():
                values[worm] = factors[name]
        self.restore(scene.start, worm)
        if scene.adaptation is not None and self._strength is not None:
            strength = scene.adaptation.at_reset(self._strength.row(worm))
            self._strength = self._strength.where(np.arange(self.n_worm) == worm, strength)

    def step(self, command: FloatArray, live: Mask | None = None) -> Step:
        """Advance by one control step.

        A worm whose physics fails gets the penalty and no other reward. Only its time advances; its motion stays that
        of its last sound moment.

        Parameters
        ----------
        command
            One number in [0, 1] for every control group, shape (n_worm, n_group).
        live
            Worms that step; None: all. The others get no reward and no time; how they move is undefined until they
            begin anew.
        """
        scene, before = self.scene, self._activation
        if self._foreign_law:
            after = scene.activation_law.advance(before.copy(), command.copy(), scene.control_dt)
            after = self._check_activation("advance", after, before.shape)
        else:
            after = scene.activation_law.advance(before, command, scene.control_dt)
        active = np.array([before[0], after[0]]).take(scene.groups, axis=-1)
        tension = scene.design.max_tension * active
        use_factor = None if self._strength is None else self._strength.factor
        factors = [factor for factor in (use_factor, self._tension_factor) if factor is not None]
        if factors:
            self.task.strength = math.prod(factors[1:], start=factors[0])
            tension *= self.task.strength
        sound = self._advance(tension, live)
        self._n_step += 1 if live is None else live
        if not self._warned_of_length and self._n_step.max() > self.task.penalised_steps:
            self._warn_of_length()
        if whole := bool(sound.all()):
            self._failed[:] = False
            self._sound_time, self._activation, self._previous_action = self.time, after, command.copy()
        else:
            self._failed = ~sound if live is None else np.where(live, ~sound, self._failed)
            self._sound_time = np.where(sound, self.time, self._sound_time)
            self._activation = np.where(sound[:, None], after, before)
            self._previous_action = np.where(sound[:, None], command, self._previous_action)
        if scene.adaptation is not None and self._strength is not None:
            mean, strain = 0.5 * (active[0] + active[1]), muscle_strain(scene.model, self.motion.position)
            strength = scene.adaptation.advance(self._strength, mean, tension.mean(axis=0), strain, scene.control_dt)
            self._strength = self._strength.where(sound, strength)
        terms, terminated = self._reward_terms(None if whole else sound, live), self.task.terminated(self.motion)
        reward: FloatArray = np.asarray(sum(terms.values()))
        self._check_reward(reward if whole else reward[sound], terms)
        terminated = terminated | self._failed
        return Step(terms, reward, terminated if live is None else terminated & live)

    def close(self) -> None:
        """End the engine's threads; a later step would begin new ones."""
        self.engine.close()

    def __getstate__(self) -> dict[str, Any]:
        """All but the engine, which is built anew, and in its place the state of every worm."""
        kept = {name: value for name, value in vars(self).items() if name not in ("engine", "motion")}
        return kept | {"states": [self.state(worm) for worm in range(self.n_worm)]}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Go on exactly from where the pickled worms stood."""
        states = state.pop("states")
        vars(self).update(state)
        self._start_engine(states)

    def _start_engine(self, states: list[RodState]) -> None:
        """Make the engine, with worms in these states, and show how they move."""
        scene = self.scene
        engine = self.engine = make_engine(
            scene.engine_name,
            self._models,
            scene.dt,
            scene.splitting,
            energy_check=scene.energy_check,
            step_check=scene.step_check,
            num_threads=self._num_threads,
        )
        for worm, state in enumerate(states):
            engine.restore(worm, state)
        self.motion = Motion(
            *map(_read_only, (engine.position, engine.velocity, engine.ball_position, engine.ball_velocity))
        )

    def _advance(self, tension: FloatArray, live: Mask | None) -> Mask:
        """Advance live worms under tensions [N], shape (2, n_worm, n_muscle), and tell which of them are sound."""
        if live is not None and not live.all():
            if not live.any():
                return live.copy()
            for worm in (self._failed & ~live).nonzero()[0].tolist():
                self.engine.restore(worm, self.scene.start)
            tension[:, ~live] = 0.0
        sound: Mask = self.engine.advance(tension, self.scene.n_substeps) == 0
        if live is not None:
            sound &= live
        if self._saved_states is not None:
            for worm in range(self.n_worm) if live is None else live.nonzero()[0].tolist():
                if sound[worm]:
                    self._saved_states[worm] = self.engine.state(worm)
                else:
                    self.engine.restore(worm, self._saved_states[worm])
        return sound

    def _reward_terms(self, sound: Mask | None, live: Mask | None) -> dict[str, FloatArray]:
        """Let the task remember the step that ends, and return its reward terms, shape (n_worm,) each.

        None: all worms are sound.
        """
        step_end = self.motion, self.activation, self._sound_time
        self._take_over(self.task.remember(*step_end), sound)
        terms = self.task.reward_terms(*step_end)
        if "terms" in self._unchecked:
            self._check_rows("terms", terms, self.n_worm)
        if sound is None:
            return terms | {DIVERGENCE: np.zeros(self.n_worm)}
        failed = self._failed if live is None else self._failed & live
        paid = {name: np.where(sound, values, 0.0) for name, values in terms.items()}
        return paid | {DIVERGENCE: np.where(failed, -self.task.penalty, 0.0)}

    def _take_over(self, changes: Mapping[str, FloatArray], sound: Mask | None) -> None:
        """Change the memory of the task, of sound worms; None: of all."""
        memory = self.task.memory
        if "remember" in self._unchecked:
            self._check_memory(changes)
        for name, values in changes.items():
            if sound is None:
                memory[name] = np.array(values)  # What it is made of may be written anew in the next step.
            else:
                memory[name] = np.where(sound.reshape(-1, *[1] * (memory[name].ndim - 1)), values, memory[name])

    def _rest(self, shape: tuple[int, ...]) -> FloatArray:
        """State of muscles long at rest, shape (n_state, *shape)."""
        law = self.scene.activation_law
        rest = law.rest(shape)
        return self._check_activation("rest", rest, (law.n_state, *shape)) if self._foreign_law else rest

    def _check_activation(self, method: str, state: object, shape: tuple[int, ...]) -> FloatArray:
        """Copy of a state that a law from outside gives; a ValueError where it is none."""
        label = f"{type(self.scene.activation_law).__name__}.{method}"
        checked: FloatArray = array(label, state, shape)  # type: ignore[arg-type]
        if not ((checked[0] >= 0.0) & (checked[0] <= 1.0)).all():
            raise ValueError(f"{label}: activations must stay from 0 to 1")
        return checked

    def _check_rows(self, method: str, values: Mapping[str, FloatArray], n: int) -> None:
        """Refuse what a method of the task gives for n worms unless it is one number a worm; done at its first call."""
        label = f"{type(self.task).__name__}.{method}"
        for name, value in names(label, values, values, "arrays").items():
            if np.shape(value) != (n,):
                raise ValueError(f"{label}: {name!r} has shape {np.shape(value)}: must have ({n},), one number a worm")
        self._unchecked.discard(method)

    def _check_memory(self, changes: Mapping[str, FloatArray]) -> None:
        """Refuse what the task would remember unless it has a place for it; done at its first call."""
        label, memory = f"{type(self.task).__name__}.remember", self.task.memory
        for name, value in names(label, changes, memory, "arrays").items():
            if np.shape(value) != memory[name].shape:
                must = f"must have {memory[name].shape}, a row a worm as `initial_memory` has it"
                raise ValueError(f"{label}: {name!r} has shape {np.shape(value)}: {must}")
        self._unchecked.discard("remember")

    def _check_reward(self, reward: FloatArray, terms: Mapping[str, FloatArray]) -> None:
        """Refuse NaN, and warn once of rewards beyond the declared ranges, which set the penalty of a divergence."""
        values, (least, most) = reward.tolist(), self.task.reward_bounds
        if all(least <= value <= most for value in values):
            return
        for name, value in terms.items():
            if np.isnan(value).any():
                raise ValueError(f"{type(self.task).__name__}.terms: {name!r} is NaN")
        if self._warned:
            return
        self._warned = True
        worst = max(values, key=lambda value: max(value - most, least - value))
        warnings.warn(
            f"{self.task.name}: a reward of {worst:g} in one control step, beyond the {least:g} to {most:g} that "
            f"its `rewards` declare; a divergence, which costs {self.task.penalty:g}, may pay more than a sound "
            "episode: widen the ranges of its reward terms",
            stacklevel=4,
        )

    def _warn_of_length(self) -> None:
        """Warn once of an episode that is longer than those for which the penalty of a divergence is made."""
        self._warned_of_length, task = True, self.task
        warnings.warn(
            f"{task.name}: an episode of more than {task.penalised_steps:g} control steps may be worth less than one "
            f"that diverges, which costs {task.penalty:g}: give time_limit, the most steps that an episode may last",
            stacklevel=4,
        )


def _read_only(values: npt.NDArray[Scalar]) -> npt.NDArray[Scalar]:
    """View of an array that cannot be written to."""
    view = values.view()
    view.flags.writeable = False
    return view
