"""The Gymnasium environment: it owns the loop from action to observation, reward and end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, get_args

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from lattice_gym.design import TURN, FloatArray, IntArray, LatticeDesign, is_number, shown, whole_number
from lattice_gym.engines import Engine, EngineName, Health, Splitting, make_engine
from lattice_gym.fidelity import FidelityName, named_fidelity
from lattice_gym.lattice import Lattice, build_lattice
from lattice_gym.measures import site_nodes
from lattice_gym.model import RodModel, RodState, build_model
from lattice_gym.muscles import MuscleLayout, advance_activation, control_groups, resolve_layout
from lattice_gym.stability import default_dt, stable_dt
from lattice_gym.tasks import TASKS, make_task

if TYPE_CHECKING:
    from lattice_gym.rendering import Renderer

Observation = npt.NDArray[np.float32]

OBSERVATIONS = ("sites", "nodes")

POSITION_SCALE = 0.2
"""Displacements are observed in units of this share of the height."""
VELOCITY_SCALE = 1.0
"""Velocities are observed in units of this many heights a second."""
OBSERVATION_BOUND = 20.0
"""Bound of observed displacements and velocities, several times what the default design reaches."""
DIVERGENCE_PENALTY = 1000.0
"""More than lies between the best and the worst episode of registered length of any task: to blow up is worse."""
SHORTEST_CONTROL_DT, LONGEST_CONTROL_DT = 1e-6, 1e3
"""Bounds of the control step [s]."""
MAX_SUBSTEPS = 1_000_000
"""More physics steps than this in one control step are a slip in dt, not a wish."""
DIVISION_TOLERANCE = 1e-9
"""A control step is a whole number of physics steps if that many differ from it by no more than this share."""
OK = str(Health())
METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20.0}


class LatticeWormEnv(gymnasium.Env[Observation, npt.NDArray[np.float32]]):
    """A soft worm of crossing helical rods, driven by muscles between the crossings.

    ## Description

    The worm is a hollow lattice: helical Cosserat rods of both chiralities on a cylinder, joined wherever they cross
    (the sites), standing on a clamped base (Schaffer, Pamu and Webster-Wood 2024). Muscles tie sites along the body
    ("vertical") or around it ("horizontal", the rings), and can only pull. The agent commands them every `control_dt`.

    | `task` | id | asked for | `muscles` | time limit |
    |---|---|---|---|---|
    | "peristalsis" | `LatticeWorm-v0`, `LatticeWormPeristalsis-v0` | a wave of ring radii | "all" | 200 steps |
    | "extension" | `LatticeWormExtension-v0` | a longer body | "extension" | 40 steps |
    | "compression" | `LatticeWormCompression-v0` | a shorter body | "compression" | 40 steps |
    | "bending" | `LatticeWormBending-v0` | a bend towards a commanded azimuth | "all" | 40 steps |

    ## Action space

    `Box(0, 1, (n_action,), float32)`: one command per control group, by default one per muscle.

    | `control` | groups | n_action for "all" muscles of the default design |
    |---|---|---|
    | "muscle" | every active muscle | 90 |
    | "ring" | level (a vertical muscle's lower one) and orientation; alike all round, so it cannot bend | 15 |
    | "column" | azimuth of the muscle's middle and orientation | 24 |
    | sequence of n_muscle whole numbers | any partition: the group of each muscle | number of groups |

    Numbers outside [0, 1] are clipped and counted in `info["clipped_actions"]`. NaN, another shape or what is no real
    number is a ValueError.

    An action is the command u of first-order activation dynamics, da/dt = (u - a) / tau with the design's rise time
    where u > a and else its decay time, solved exactly over the control step. Within the step both engines take the
    tension as linear in time, from max_tension times the activation at its start to that at its end.

    ## Observation space

    `Box(float32)`, flat, with finite bounds. In this order:

    | part | count | unit | bound |
    |---|---|---|---|
    | displacement from rest of each point (x, y, z) | 3 n_point | 0.2 height | +-20 |
    | velocity of each point (x, y, z) | 3 n_point | height / s | +-20 |
    | activation of each control group: its muscles share one | n_action | 1 | 0 to 1 |
    | what the task commands, see below | 0, 2 or 5 | | |
    | with `rhythm`: cosine and sine of a clock that starts with the episode | 2 | 1 | +-1 |

    Points are the sites ("sites", each the mean of its two nodes) or all nodes of the structure rods ("nodes"), without
    those that the base holds in place: 48 sites or 480 nodes in the default design. Displacements and velocities beyond
    their bound are clipped to it and counted in `info["clipped_observations"]`; in the default design none come near.

    | task | what it commands | bound |
    |---|---|---|
    | extension, compression | nothing | |
    | bending | cosine and sine of the azimuth | +-1 |
    | peristalsis | cosine and sine of the wave's phase at the base, now | +-1 |
    | peristalsis | speed / (height / s), wavelength / height, amplitude / 0.055 | +-10 |

    ## Rewards

    The reward is the sum of `info["reward_terms"]`, in their order, to the last bit. Doing nothing earns nothing.

    | task | term | value at the end of the control step |
    |---|---|---|
    | extension | `strain` | strain: mean rise of the rods' tops above the base over the height |
    | compression | `strain` | minus the strain |
    | bending | `bend` | part of the bend towards the commanded azimuth [rad] |
    | bending | `sideways` | minus the size of its part across [rad] |
    | peristalsis | `tracking` | how well the commanded wave is followed, from -1 to 2, see below |
    | all | `effort` | minus 0.01 times the mean squared activation of the muscles |
    | all | `divergence` | 0; or -1000 where the physics diverged, and then all other terms are 0 |

    With d the deviation of each ring's radius from rest and t the commanded one, as shares of the rest radius, and sums
    over the n levels that can move, tracking = (sum t^2 - sum (d - t)^2) / (n amplitude^2 / 2 + sum (d - t)^2): 0 for
    doing nothing, sum t^2 / (n amplitude^2 / 2) for following perfectly, which is 1 on average, and never below -1.

    Bend, azimuth and strain are relative to the base: under a free body, to its bottom ring, so that a rigid motion of
    the whole body is neither bend nor strain.

    ## Starting state

    At rest, free of stress, activations 0. Only the command is random, uniform over the ranges below. Numbers given as
    `command` are held in every episode, those in `reset(options={...})` in that one; the options win.

    | task | name | drawn from | may be given |
    |---|---|---|---|
    | bending | `azimuth` [rad] | 0 to 2 pi | -2 pi to 2 pi |
    | peristalsis | `speed` [m/s], up is positive | 0.8 to 1.2 heights / s | 0.1 to 10 heights / s, up or down |
    | peristalsis | `wavelength` [m] | 0.8 to 1.2 heights | 3 level spacings to 10 heights |
    | peristalsis | `amplitude` over the rest radius | 0.04 to 0.07 | 0.001 to 0.5 |
    | peristalsis | `phase` at the base at the start [rad] | 0 to 2 pi | -2 pi to 2 pi |

    A period of the wave must last at least 4 control steps.

    ## Episode end

    `terminated` only where the physics diverges: a state that is not finite, an element inverted or over-stretched, a
    joint torn or, where asked for, energy from nowhere (`energy_check`) or too long a step (`step_check`); see
    `engines.Status`. Then `info["status"]` names what and where, by rod and element, and the observation is the last
    sound one, again; `time` is that of the control step that failed. The penalty exceeds what lies between the best and
    the worst episode of registered length in any task, so none that ends well is worth less. The environment never
    truncates itself: the time limit is registered.

    ## Info

    After a step: `reward_terms` and `outcome` (names to floats), `status` ("ok", or what went wrong and where),
    `clipped_actions`, `clipped_observations` (counts). After a reset: `command` (names to floats) and `status`.

    | task | `outcome`, which is not the reward |
    |---|---|
    | extension, compression | `strain` |
    | bending | `bend_angle` [rad], `bend_direction` (azimuth) [rad] |
    | peristalsis | `wave_index` (1 is a pure travelling wave, 0 a standing one, noise or none) |
    | peristalsis | `wave_direction` (+1 up, -1 down, 0 neither), `wave_speed` [m/s] |
    | peristalsis | `wave_amplitude` over the rest radius: of the dominant mode, wave or not |

    The wave is that of the ring radii over the last two commanded periods, and 0 before two have passed; its value at
    the end of an episode is the one to report. Index, direction and speed are given only to motion that stands out of
    noise, see `measures.travelling_wave`.

    ## Fidelity

    | `fidelity` | elements per segment | `splitting` | error of strain, bend, rings | return | cost |
    |---|---|---|---|---|---|
    | "fast" | at most 2 | "symmetric" | 4 %, 4 %, 9 % | -2.3 % (-3.6 %) | 8 ms |
    | "default" | the design's (here 5) | "symmetric" | 1.3 %, 1.7 %, 3.1 % | -0.6 % (-0.9 %) | 30 ms |
    | "fine" | at least 16 | "symmetric" | 0.4 %, 0.5 %, 0.9 % | 0 | 200 ms |

    Errors are the largest at any time, over the largest change, against vanishing elements. Of them the time step makes
    0.01 % or less with "symmetric". The return is that of a hand-made gait over an episode, against "fine": mean over
    the tasks (and worst). The cost is computing per simulated second on the fused engine.
    `python -m lattice_gym.reports work-precision` measured all of it, on the default design.

    Train on "fast", which is three times cheaper than "default", and measure what is to be reported on "default" or
    "fine": sites, and so observations, are the same on all. With `observation="nodes"` they are not. A mesh that a
    fidelity sets has the damping per length of the design's own.

    Arguments
    ---------
    task
        "extension", "compression", "bending" or "peristalsis".
    design
        LatticeDesign or its dict form; None: the default one.
    muscles
        "extension", "compression", "bending", "all", a MuscleLayout or its dict form; None: the task's own.
    control
        How actions drive muscles, see above.
    rhythm
        Frequency of the observed clock [Hz], at most half the control rate; None: no clock.
    fidelity
        "fast", "default" or "fine": mesh and damping, see above.
    splitting
        When velocities are damped: "symmetric", all along the kick (second order in `dt`, fused engine only), or
        "pyelastica", all of it after (first order); None: as the fidelity says, or as the pyelastica engine must.
    engine
        "fused" or "pyelastica".
    dt
        Physics time step [s], a whole fraction of `control_dt`; None: the largest one below `stability.DT_MARGIN` of
        the predicted stable step.
    allow_large_dt
        Take a `dt` above the predicted stable step.
    energy_check
        Draw up the energy ledger of every control step and end an episode where energy came from nowhere. The law of
        rods that are sheared and stretched at once is no potential's: a violent snap may be flagged at any step.
    step_check
        Take a run at half the step along and end an episode where it leads elsewhere, by more than
        `engines.STEP_TOLERANCE` of the longest side: the one check that also catches a run which goes astray smoothly,
        as near a snap. Three times the computing. A pickled environment begins the comparison anew.
    control_dt
        Time between actions [s].
    observation
        "sites" or "nodes".
    command
        Commanded numbers, by name, to hold in every episode.
    render_mode
        None or "rgb_array".

    An argument that cannot be used is a ValueError that names it. With dict forms, and with objects too, an EnvSpec
    survives JSON and makes an equal environment. NumPy numbers and arrays are taken too, but JSON knows only plain
    ones: where a spec is to be written, give `.item()` or `.tolist()` of them. Pickles and deep copies go on exactly
    where the original stood.

    Version history
    ---------------
    v0: first version.
    """

    metadata = METADATA
    action_space: spaces.Box[np.float32]
    observation_space: spaces.Box[np.float32]

    def __init__(
        self,
        task: str = "peristalsis",
        design: LatticeDesign | Mapping[str, Any] | None = None,
        muscles: str | MuscleLayout | Mapping[str, Any] | None = None,
        control: str | Sequence[int] | IntArray = "muscle",
        rhythm: float | None = None,
        fidelity: FidelityName = "default",
        splitting: Splitting | None = None,
        engine: EngineName = "fused",
        dt: float | None = None,
        allow_large_dt: bool = False,
        energy_check: bool = False,
        step_check: bool = False,
        control_dt: float = 0.05,
        observation: str = "sites",
        command: Mapping[str, float] | None = None,
        render_mode: str | None = None,
    ) -> None:
        _check_choice("task", task, tuple(TASKS))
        _check_choice("observation", observation, OBSERVATIONS)
        _check_choice("engine", engine, get_args(EngineName))
        if render_mode is not None:
            _check_choice("render_mode", render_mode, tuple(METADATA["render_modes"]))
        self.control_dt = _number("control_dt", control_dt, SHORTEST_CONTROL_DT, LONGEST_CONTROL_DT, "s")
        self.rhythm = None if rhythm is None else _number("rhythm", rhythm, 0.0, 0.5 / self.control_dt, "Hz")
        preset = named_fidelity(fidelity)
        self.design = preset.remesh(_design(design))
        self.lattice = build_lattice(self.design)
        self.layout = resolve_layout(TASKS[task].layout if muscles is None else muscles, self.lattice)
        self.groups = control_groups(control, self.layout, self.lattice)
        self.task = make_task(task, self.lattice, self.control_dt, command)
        self.model = build_model(self.lattice, self.layout)
        preferred: Splitting = "pyelastica" if engine == "pyelastica" else preset.splitting
        self.splitting: Splitting = preferred if splitting is None else splitting
        self.n_substeps, self.dt = self._substeps(dt, allow_large_dt)
        self.engine_name = engine
        self.energy_check, self.step_check = energy_check, step_check
        self.observation = observation
        self.render_mode = render_mode
        self.metadata = {**METADATA, "render_fps": 1.0 / self.control_dt}
        self._renderer: Renderer | None = None
        self._engine: Engine = self._make_engine()

        self._point_nodes = _observed_nodes(self.model, self.lattice, observation)
        self._rest_points = self.model.rest_state().position[self._point_nodes].mean(axis=1)
        n_action = int(self.groups.max()) + 1
        self.action_space = spaces.Box(0.0, 1.0, (n_action,), np.float32)
        self.observation_space = self._space(n_action)
        self._state = self.model.rest_state()
        self._activation = np.zeros(n_action)
        self._n_step = 0
        self._running = False

    @property
    def state(self) -> RodState:
        """Copy of the state of all rods."""
        return self._state.copy()

    @property
    def activation(self) -> FloatArray:
        """Activation of every active muscle now, shape (n_muscle,), in [0, 1]."""
        return self._activation[self.groups]

    @property
    def time(self) -> float:
        """Time since the episode began [s], at the end of the last control step, be it one that failed."""
        return self._n_step * self.control_dt

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode at rest; options hold commanded numbers, by name, for this episode."""
        if seed is not None and ((number := whole_number(seed)) is None or number < 0):
            raise ValueError(f"seed = {shown(seed)}: must be None or a whole number, 0 or more")
        super().reset(seed=None if seed is None else int(seed))
        self.task.begin(self.np_random, options)
        self._rest()
        self._running = True
        observation, _ = self._observe()
        return observation, {"command": dict(self.task.command), "status": OK}

    def step(self, action: npt.ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by `control_dt`."""
        if not self._running:
            raise gymnasium.error.ResetNeeded("reset() must be called first, and again once an episode has terminated")
        command, n_clipped = self._command(action)
        design, before = self.design, self._activation
        after = advance_activation(before, command, self.control_dt, design.rise_time, design.decay_time)
        tension = design.max_tension * np.stack([before, after])[:, self.groups]
        health = self._engine.advance(tension, self.n_substeps)
        if health.ok:
            self._state, self._activation, self._n_step = self._engine.state, after, self._n_step + 1
            terms = self.task.terms(self._state.position, self.activation, self.time) | {"divergence": 0.0}
        else:
            self._engine.restore(self._state)
            self._running = False
            terms = dict.fromkeys(self.task.term_names, 0.0) | {"divergence": -DIVERGENCE_PENALTY}
        observation, n_beyond = self._observe()
        if not health.ok:
            # Not before the last sound moment was observed.
            self._n_step += 1
        info = {
            "reward_terms": terms,
            "outcome": self.task.outcome(self._state.position),
            "status": str(health),
            "clipped_actions": n_clipped,
            "clipped_observations": n_beyond,
        }
        return observation, sum(terms.values()), not health.ok, False, info

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Picture of the worm now, shape (480, 640, 3); None without a render mode."""
        if self.render_mode is None:
            return None
        if self._renderer is None:
            from lattice_gym.rendering import Renderer

            self._renderer = Renderer(self.lattice, self.model)
        position = self._state.position
        caption, bolus = self.task.caption(position), self._state.bolus_position
        return self._renderer.update(position, self.activation, self.time, caption, bolus)

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        """All but the engine and the renderer, which are built anew."""
        return {name: value for name, value in vars(self).items() if name not in ("_engine", "_renderer")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Go on exactly from where the pickled environment stood."""
        vars(self).update(state)
        self._renderer = None
        self._engine = self._make_engine()
        self._engine.restore(self._state)

    def _make_engine(self) -> Engine:
        return make_engine(self.engine_name, self.model, self.dt, self.splitting, self.energy_check, self.step_check)

    def _substeps(self, dt: object, allow_large_dt: object) -> tuple[int, float]:
        """Physics steps in a control step, and their length [s]."""
        if not isinstance(allow_large_dt, bool):
            raise ValueError(f"allow_large_dt = {allow_large_dt!r}: must be True or False")
        control_dt, tension = self.control_dt, self.design.max_tension
        step = default_dt(self.model, control_dt, tension) if dt is None else _number("dt", dt, 0.0, control_dt, "s")
        ratio = control_dt / step
        if ratio > MAX_SUBSTEPS:
            raise ValueError(
                f"dt = {step:g}: {ratio:.3g} steps in control_dt = {control_dt:g} s, at most {MAX_SUBSTEPS}"
            )
        n_substeps = round(ratio)
        if abs(n_substeps * step - control_dt) > DIVISION_TOLERANCE * control_dt:
            nearest = f"{control_dt / (int(ratio) + 1)!r} and {control_dt / int(ratio)!r}"
            raise ValueError(
                f"dt = {step!r}: must divide control_dt = {control_dt!r} s; the nearest that do: {nearest} s"
            )
        if dt is not None and not allow_large_dt and step > (limit := stable_dt(self.model, tension, self.splitting)):
            raise ValueError(f"dt = {step!r}: above the predicted stable {limit:.6g} s; allow_large_dt=True permits it")
        return n_substeps, step

    def _rest(self) -> None:
        self._state = self.model.rest_state()
        self._engine.restore(self._state)
        self._activation = np.zeros_like(self._activation)
        self._n_step = 0

    def _command(self, action: npt.ArrayLike) -> tuple[FloatArray, int]:
        """Clipped commands, one per group, and how many were clipped."""
        try:
            given = np.asarray(action)
        except ValueError:
            raise ValueError(f"action: must be an array of shape {self.action_space.shape}, got {action!r}") from None
        if given.dtype.kind not in "fiu":
            raise ValueError(f"action: must hold real numbers, got {given.dtype}")
        if given.shape != self.action_space.shape:
            raise ValueError(f"action: shape must be {self.action_space.shape}, got {given.shape}")
        if np.isnan(given).any():
            raise ValueError(f"action: must not be NaN, got NaN in {np.flatnonzero(np.isnan(given)).tolist()}")
        command = np.clip(given.astype(np.float64), 0.0, 1.0)
        return command, int(np.count_nonzero(command != given))

    def _observe(self) -> tuple[Observation, int]:
        """Observation, and how many of its displacements and velocities lay beyond their bound."""
        height = self.design.height
        displacement = self._state.position[self._point_nodes].mean(axis=1) - self._rest_points
        velocity = self._state.velocity[self._point_nodes].mean(axis=1)
        moving = np.concatenate(
            [displacement.ravel() / (POSITION_SCALE * height), velocity.ravel() / (VELOCITY_SCALE * height)]
        )
        bounded = np.clip(moving, -OBSERVATION_BOUND, OBSERVATION_BOUND)
        parts = [bounded, self._activation, self.task.observe(self.time)]
        if self.rhythm is not None:
            angle = TURN * self.rhythm * self.time
            parts.append(np.array([np.cos(angle), np.sin(angle)]))
        return np.concatenate(parts).astype(np.float32), int(np.count_nonzero(bounded != moving))

    def _space(self, n_action: int) -> spaces.Box[np.float32]:
        n_moving = 6 * len(self._point_nodes)
        bounds = np.array(self.task.bounds + (() if self.rhythm is None else (1.0, 1.0)))
        high = np.concatenate([np.full(n_moving, OBSERVATION_BOUND), np.ones(n_action), bounds])
        low = np.concatenate([np.full(n_moving, -OBSERVATION_BOUND), np.zeros(n_action), -bounds])
        return spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


def _check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{name} = {value!r}: must be one of {', '.join(choices)}")


def _number(name: str, value: object, low: float, high: float, unit: str) -> float:
    """Positive number within bounds."""
    if is_number(value) and value > 0.0 and low <= value <= high:
        return float(value)
    raise ValueError(f"{name} = {value!r}: must be a number from {low:g} to {high:g} [{unit}], and not 0")


def _design(design: object) -> LatticeDesign:
    if design is None:
        return LatticeDesign()
    if isinstance(design, LatticeDesign):
        return design
    if isinstance(design, Mapping):
        return LatticeDesign.from_dict(design)
    raise ValueError(f"design = {design!r}: must be a LatticeDesign, its dict form or None")


def _observed_nodes(model: RodModel, lattice: Lattice, observation: str) -> IntArray:
    """Rows of the nodes whose mean is an observed point, shape (n_point, 1 or 2); none that a clamp holds."""
    nodes = site_nodes(lattice) if observation == "sites" else np.arange(lattice.n_rod * lattice.n_node)[:, None]
    held = [model.node_offset[clamp.rod] + clamp.node for clamp in model.clamps if clamp.node is not None]
    return nodes[~np.isin(nodes, held).any(axis=1)]
