"""The Gymnasium environment: it owns the loop from action to observation, reward and end."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import MuscleLayout, control_groups, resolve_layout
from lattice_gym.checks import FloatArray, IntArray, Part, is_number, shown, whole_number
from lattice_gym.engines.health import Health
from lattice_gym.engines.registry import ENGINES, EngineName
from lattice_gym.engines.simulation import Simulation, simulate
from lattice_gym.envs.episode import Episodes
from lattice_gym.envs.fidelity import FidelityName, named_fidelity
from lattice_gym.envs.observation import OBSERVATIONS, Observation, Observer
from lattice_gym.envs.randomisation import Randomisation, varied
from lattice_gym.envs.registration import warn_of_time_limit
from lattice_gym.physics.laws.adaptation import Adaptation
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.stable_step import default_dt, stable_dt
from lattice_gym.physics.state import Motion, RodState
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model
from lattice_gym.tasks.base import Given, Task
from lattice_gym.tasks.registry import resolve_task, warn_of_dropped_values

if TYPE_CHECKING:
    from lattice_gym.rendering.scene import Renderer


SHORTEST_CONTROL_DT, LONGEST_CONTROL_DT = 1e-6, 1e3
"""Bounds of the control step [s]."""
MAX_SUBSTEPS = 1_000_000
"""More physics steps than this in one control step are a slip in dt, not a wish."""
DIVISION_TOLERANCE = 1e-9
"""A control step is a whole number of physics steps if that many differ from it by no more than this share."""
SETTLING_SPAN, LONGEST_SETTLING = 0.5, 30.0
"""How often, while worm and ball settle, it is looked whether they are at rest; when that ends at the latest [s]."""
SETTLING_DRAG = 0.05
"""Largest drag of a medium while worm and ball settle [N s/m^2]: more holds up a worm that rolls over, and where all
comes to rest it is the same."""
QUIET, AT_REST = 1e-4, 1e-3
"""Largest speed of a node or ball at which settling ends, and at which an episode may start at all [heights / s].

A crawler that is damped as much as other tasks' worms is, comes down to the second only. In the tasks' own worlds the
first is reached, and doing nothing then earns less than 0.0001 a step."""
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
    | "reach" | `LatticeWormReach-v0` | the top's centre at a commanded place | "all" | 60 steps |
    | "crawl" | `LatticeWormCrawl-v0` | a way over the ground, along +x or -x | "all" | 200 steps |
    | "transport" | `LatticeWormTransport-v0` | a ball inside carried up or down | "all" | 200 steps |

    The crawling worm is free, lies along x in water on a ground with friction (`World`), and has a tenth of the default
    damping, 0.003 N s/m per node: that resists all motion, and would outdo friction. The water has a drag of 1 N s/m^2,
    that of a rod at 0.13 m/s: without it the worm, nearly weightless, hops sooner than it crawls. Transport has muscles
    of 1 N and, between the two rings halfway up, a ball of friction 0.1, as dense as the medium, of a radius 9 % larger
    than the room that the ring muscles leave: 30 mm by default.

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
    tension as linear in time, from max_tension times the activation at its start to that at its end. With `hill` the
    muscle's length and speed then multiply it, in every element and physics step; with `adaptation` its strength does.

    ## Observation space

    `Box(float32)`, flat, with finite bounds. In this order:

    | part | count | unit | bound |
    |---|---|---|---|
    | displacement from rest of each point (x, y, z) | 3 n_point | 0.2 height | +-20 |
    | velocity of each point (x, y, z) | 3 n_point | height / s | +-20 |
    | activation of each control group: its muscles share one | n_action | 1 | 0 to 1 |
    | what the task commands, see below | 0 to 7 | | |
    | with `rhythm`: cosine and sine of a clock that starts with the episode | 2 | 1 | +-1 |
    | with an observed `adaptation`: strength of each muscle | n_muscle | that of the design | 0 to its cap |

    Points are the sites ("sites", each the mean of its two nodes) or all nodes of the structure rods ("nodes"), without
    those that the base holds in place: 48 sites or 480 nodes in the default design. Displacements and velocities beyond
    their bound are clipped to it and counted in `info["clipped_observations"]`; in the default design none come near.
    Of a worm that crawls, displacements in x and y are less their mean over the points. A ball is observed in transport
    only, and its spin never.

    | task | what it commands | bound |
    |---|---|---|
    | extension, compression | nothing | |
    | bending | cosine and sine of the azimuth | +-1 |
    | peristalsis | cosine and sine of the wave's phase at the base, now | +-1 |
    | peristalsis | speed / (height / s), wavelength / height, amplitude / 0.055 | +-10 |
    | reach | way from the top's centre to the target (x, y, z) / 0.2 height, clipped to the bound | +-10 |
    | crawl | direction | +-1 |
    | crawl | way of the centre of mass to +y / height, clipped to the bound | +-10 |
    | transport | direction | +-1 |
    | transport | way of the ball from its start (x, y, z) / 0.2 height, clipped to the bound | +-10 |
    | transport | velocity of the ball (x, y, z) / (height / s), clipped to the bound | +-10 |

    `LatticeWormGoalEnv` (id `LatticeWormReachGoal-v0`) observes goals apart, for hindsight replay. Many worms at once:
    `vector_env.LatticeWormVectorEnv`, which `gymnasium.make_vec` makes.

    ## Rewards

    The reward is the sum of `info["reward_terms"]`, in their order, to the last bit. Doing nothing earns nothing;
    in crawl and transport, where the last of settling dies away, less than 0.0001 a step in their own worlds.

    | task | term | value at the end of the control step |
    |---|---|---|
    | extension | `strain` | strain: mean rise of the rods' tops above the base over the height |
    | compression | `strain` | minus the strain |
    | bending | `bend` | part of the bend towards the commanded azimuth [rad] |
    | bending | `sideways` | minus the size of its part across [rad] |
    | peristalsis | `tracking` | how well the commanded wave is followed, from -1 to 2, see below |
    | reach | `approach` | target's distance from where the top's centre rests, less that from where it is [height] |
    | crawl | `progress` | 10 times the centre of mass's way along the command in this step [height] |
    | transport | `progress` | 10 times the ball's way in the body along the command in this step [height] |
    | transport | `lost` | -5 where the ball has left the body other than by the commanded end, else 0 |
    | all | `effort` | minus 0.01 times the mean squared activation of the muscles |
    | all | `divergence` | 0; or -1000 where the physics diverged, and then all other terms are 0 |

    Numbers here, signs aside, are weights, 1 where there is none: `reward_weights` changes them. The penalty of a
    divergence is then `task.penalty`: 1000, or more where that is less than the terms can differ by in an episode.

    With d the deviation of each ring's radius from rest and t the commanded one, as shares of the rest radius, and sums
    over the n levels that can move, tracking = (sum t^2 - sum (d - t)^2) / (n amplitude^2 / 2 + sum (d - t)^2): 0 for
    doing nothing, sum t^2 / (n amplitude^2 / 2) for following perfectly, which is 1 on average, and never below -1.

    The ball's place in the body is where the line from ring centre to ring centre comes nearest to it, in rest heights.
    It has left by an end where it lies beyond the plane through the last ring's centre across that line, and sideways
    where it is further from the line than the mean radius of the rings there (`measures.lodging`).

    Bend, azimuth and strain are relative to the base: under a free body, to its bottom ring, so that a rigid motion of
    the whole body is neither bend nor strain.

    ## Starting state

    At rest, free of stress, activations 0, strengths 1 unless an `adaptation` carries them. In crawl and transport worm
    and ball came to rest first, with slack muscles, and displacements count from there: until none of their points was
    faster than 0.0001 heights a second, for 30 s at most, in a medium of at most 0.05 N s/m^2, as drag only delays it
    there. What is then faster than 0.001, or has left the body, is a ValueError. In other tasks a worm with weight sags
    from the start, and that counts. Only the command is random, uniform over the ranges below. Numbers given as
    `command` are held in every episode, those in `reset(options={...})` in that one; the options win. Of a list in
    place of a number, one is drawn for each episode.

    | task | name | drawn from | may be given |
    |---|---|---|---|
    | bending | `azimuth` [rad] | 0 to 2 pi | -2 pi to 2 pi |
    | peristalsis | `speed` [m/s], up is positive | 0.8 to 1.2 heights / s | 0.1 to 10 heights / s, up or down |
    | peristalsis | `wavelength` [m] | 0.8 to 1.2 heights | 3 level spacings to 10 heights |
    | peristalsis | `amplitude` over the rest radius | 0.04 to 0.07 | 0.001 to 0.5 |
    | peristalsis | `phase` at the base at the start [rad] | 0 to 2 pi | -2 pi to 2 pi |
    | reach | `azimuth` of the target [rad] | 0 to 2 pi | -2 pi to 2 pi |
    | reach | `radius`: its distance from the axis [heights] | 0.05 to 0.2 | 0 to 1.5 |
    | reach | `rise`: its height above the top at rest [heights] | -0.08 to 0 | -1 to 1.5 |
    | crawl | `direction` along x | -1 or 1 | -1 or 1 |
    | transport | `direction` up the body | -1 or 1 | -1 or 1 |

    A period of the wave must last at least 4 control steps. `tasks.reach.EIGHT_TARGETS` is a command of reach: eight
    targets on a circle, as in Schaffer et al. (arXiv 2408.16069).

    ## Episode end

    `terminated` in transport where the ball has left the body, and else only where the physics diverges: a state that
    is not finite, an element inverted or over-stretched, a joint torn or, where asked for, energy from nowhere
    (`energy_check`) or too long a step (`step_check`); see `engines.Status`. Then `info["status"]` names what and
    where, by rod and element, and the observation is the last sound one, again; `time` is that of the control step that
    failed. The penalty exceeds what lies between the best and the worst episode within the task's time limit, so none
    that ends well is worth less. The environment never truncates itself: the time limit is registered.

    ## Info

    After a step: `reward_terms` and `outcome` (names to floats), `status` ("ok", or what went wrong and where),
    `clipped_actions`, `clipped_observations` (counts). After a reset: `command` (names to floats) and `status`. With an
    `adaptation` both hold `strength`, that of every active muscle over the design's, shape (n_muscle,). With
    `randomise` a reset tells the `factors` drawn, by name; that of "strength" has shape (n_muscle,).

    | task | `outcome`, which is not the reward |
    |---|---|
    | extension, compression | `strain` |
    | bending | `bend_angle` [rad], `bend_direction` (azimuth) [rad] |
    | peristalsis | `wave_index` (1 is a pure travelling wave, 0 a standing one, noise or none) |
    | peristalsis | `wave_direction` (+1 up, -1 down, 0 neither), `wave_speed` [m/s] |
    | peristalsis | `wave_amplitude` over the rest radius: of the dominant mode, wave or not |
    | reach | `distance` of the top's centre from the target [m] |
    | reach | `reached`: 1 once it came within 0.03 heights, else 0; `reach_time`: when it first did [s], else 0 |
    | crawl | `speed` along the command since the start [body heights a minute] |
    | crawl | `drift`: angle between the way so far and the command [rad]; 0 before 0.01 heights |
    | crawl | `cost_of_transport`, see below; 0 before 0.01 heights along the command |
    | transport | `distance` of the ball along the command [m], `speed`: that over time [m/s] |
    | transport | `held`: 0 once it is lost, else 1; `delivered`: 1 once it left by the commanded end, else 0 |

    The cost of transport is the muscles' positive work over weight (without buoyancy) times way along the command. Work
    is reckoned from the ends of control steps: mean tension times what a muscle has shortened by, and nothing where it
    was lengthened. It bounds nothing: the net work is far less, as most is stored and given back, and positive work
    summed over physics steps up to 40 % more. The tension is that of the muscle's strength, before the factors of
    `hill`, which can only lessen the pull of one that shortens.

    The wave is that of the ring radii over the last two commanded periods, and 0 before two have passed; its value at
    the end of an episode is the one to report. Index, direction and speed are given only to motion that stands out of
    noise, see `measures.travelling_wave`.

    ## Fidelity

    | `fidelity` | elements per segment | `splitting` | error of strain, bend, rings | return | cost |
    |---|---|---|---|---|---|
    | "fast" | at most 2 | "symmetric" | 4 %, 4 %, 9 % | -2.3 % (-3.6 %) | 6 ms |
    | "default" | the design's (here 5) | "symmetric" | 1.3 %, 1.7 %, 3.1 % | -0.6 % (-0.9 %) | 20 ms |
    | "fine" | at least 16 | "symmetric" | 0.4 %, 0.5 %, 0.9 % | 0 | 100 ms |

    Errors are the largest at any time, over the largest change, against vanishing elements. Of them the time step makes
    0.01 % or less with "symmetric". The return is that of a hand-made gait over an episode, against "fine": mean over
    extension, compression, bending and peristalsis (and worst). The cost is computing per simulated second on the fused
    engine. `python -m lattice_gym.benchmarks work-precision` measured all of it, on the default design.

    Train on "fast", which is three times cheaper than "default", and measure what is to be reported on "default" or
    "fine": sites, and so observations, are the same on all. With `observation="nodes"` they are not. A mesh that a
    fidelity sets has the damping per length of the design's own.

    Arguments
    ---------
    task
        "extension", "compression", "bending", "peristalsis", "reach", "crawl" or "transport"; or a `Task` of your own:
        the class, or "module:Class", which a spec as JSON can hold too. An id keeps its time limit whatever the task:
        `lattice_gym.register_task` makes one that has the task's.
    design
        LatticeDesign; or a dict of what differs from the task's own; None: the task's own, the default one for most.
        `lattice_gym.design_for("crawl", height=0.2)` is a LatticeDesign that differs from the task's own in the height.
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
        `step_doubling.STEP_TOLERANCE` of the longest side: the one check that also catches a run which goes astray
        smoothly, as near a snap. Three times the computing. A pickled environment begins the comparison anew.
    control_dt
        Time between actions [s].
    observation
        "sites" or "nodes".
    command
        Commanded numbers, by name, to hold in every episode, or lists to draw one from for each.
    world
        Medium, ground and bolus around the worm and whether it lies: a World, or a dict of what differs from the task's
        own; None: the task's own, nothing at all for most. A part given as a dict changes the task's own part, or where
        that has none the default one; an object replaces it, None takes it away. One that lies needs a free base, crawl
        lies on a ground under gravity, and in crawl and transport worm and ball must come to rest in it.
    reward_weights
        Weights of reward terms by name in place of the task's own, "effort" among them: {"effort": 0.02}. The penalty
        of a divergence rises with them.
    render_mode
        None or "rgb_array".
    adaptation
        `adaptation.Adaptation` or its dict form: how use changes the strength of each muscle, updated after every
        control step from its mean activation, its mean tension (before the factors of `hill`) and its strain at the
        end. None: not at all. The default `dt` is that for the largest strength there can be.
    hill
        `hill.Hill` or its dict form: how the force of each muscle depends on its length and speed. None: not at all.
    randomise
        Factors that are drawn for every episode, after its command, uniformly from ranges: a mapping of names to pairs
        (low, high) from 0.01 to 100. "structure_youngs_modulus" and "muscle_youngs_modulus" (with the shear moduli),
        "damping" (of all rods, rotational too, not that of joints or a medium), "max_tension", and "strength", one for
        each muscle. The default `dt` is the smallest at any corner of the ranges and the largest tension; episodes
        start from the state at rest of the design itself, which after settling another body leaves slowly. Nothing of
        it is observed. None: every worm is as designed.

    An argument that cannot be used is a ValueError that names it. With dict forms, and with objects too, an EnvSpec
    survives JSON and makes an equal environment. NumPy numbers and arrays are taken too, but JSON knows only plain
    ones: where a spec is to be written, give `.item()` or `.tolist()` of them. Pickles and deep copies go on exactly
    where the original stood.

    Version history
    ---------------
    v0: first version.
    """

    metadata = METADATA
    _goals_apart: ClassVar[bool] = False
    """Whether goals are observed apart."""
    action_space: spaces.Box[np.float32]
    observation_space: spaces.Space[Any]

    def __init__(
        self,
        task: str | type[Task] = "peristalsis",
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
        command: Given | None = None,
        world: World | Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        adaptation: Adaptation | Mapping[str, Any] | None = None,
        hill: Hill | Mapping[str, Any] | None = None,
        randomise: Mapping[str, Sequence[float]] | None = None,
        reward_weights: Mapping[str, float] | None = None,
    ) -> None:
        kind = resolve_task(task)
        _check_choice("observation", observation, OBSERVATIONS)
        _check_choice("engine", engine, tuple(ENGINES))
        if render_mode is not None:
            _check_choice("render_mode", render_mode, tuple(METADATA["render_modes"]))
        self.control_dt = _number("control_dt", control_dt, SHORTEST_CONTROL_DT, LONGEST_CONTROL_DT, "s")
        self.rhythm = None if rhythm is None else _number("rhythm", rhythm, 0.0, 0.5 / self.control_dt, "Hz")
        preset = named_fidelity(fidelity)
        self.design = preset.remesh(_design(design, kind.design))
        self.lattice = build_lattice(self.design)
        self.layout = kind.muscles(self.lattice) if muscles is None else resolve_layout(muscles, self.lattice)
        self.groups = control_groups(control, self.layout, self.lattice)
        self.world = _world(world, kind.world, self.lattice)
        if self.world.lying and self.design.base == "clamped":
            raise ValueError("world: a worm that lies needs a free base (design.base); on a clamped one it stands")
        self.adaptation = Adaptation.resolve("adaptation", adaptation)
        self.randomisation = Randomisation.resolve(randomise)
        self.model = build_model(self.lattice, self.layout, self.world, hill=Hill.resolve("hill", hill))
        self._given: dict[str, Any] = {"command": command, "reward_weights": reward_weights}
        self.task = kind(self.lattice, self.control_dt, model=self.model, **self._given)
        if isinstance(design, LatticeDesign):
            warn_of_dropped_values(design, kind)
        preferred: Splitting = "pyelastica" if engine == "pyelastica" else preset.splitting
        self.splitting: Splitting = preferred if splitting is None else splitting
        self.n_substeps, self.dt = self._substeps(dt, allow_large_dt)
        self.engine_name = engine
        self.energy_check, self.step_check = energy_check, step_check
        self.observation = observation
        self.render_mode = render_mode
        self.metadata = {**METADATA, "render_fps": 1.0 / self.control_dt}
        self._renderer: Renderer | None = None
        self._body = self.model
        self._engine: Simulation = self._make_engine()

        self.task.rest = self._start = self._settled()
        self._episode = self._episodes(self.task)
        self.action_space = spaces.Box(0.0, 1.0, self._episode.activation.shape[1:], np.float32)
        self.observation_space = self._episode.observer.space
        self._state = self._start.copy()
        self._running = False

    @property
    def state(self) -> RodState:
        """Copy of the state of all rods."""
        return self._state.copy()

    @property
    def start(self) -> RodState:
        """Copy of the state in which episodes start."""
        return self._start.copy()

    @property
    def activation(self) -> FloatArray:
        """Activation of every active muscle now, shape (n_muscle,), in [0, 1]."""
        activation: FloatArray = self._episode.activation[0, self.groups]
        return activation

    @property
    def strength(self) -> FloatArray:
        """Strength of every active muscle now, over that of the design, shape (n_muscle,)."""
        strength = self._episode.strength
        return np.ones(self.model.n_muscle) if strength is None else strength[0]

    @property
    def time(self) -> float:
        """Time since the episode began [s], at the end of the last control step, be it one that failed."""
        return int(self._episode.n_step[0]) * self.control_dt

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode at rest; options hold commanded numbers, by name, for this episode."""
        super().reset(seed=None if seed is None else seed_of(seed))
        warn_of_time_limit(self.spec, type(self.task), int(self._episode.n_step[0]))
        factors = self._episode.begin(self.np_random, options)
        if factors:
            self._body = varied(self.model, factors)
            self._engine = self._make_engine()
        self._state = self._start.copy()
        self._engine.restore(self._state)
        self._running = True
        observation, _ = self._observe()
        told = {"factors": dict(factors)} if factors else {}
        return observation, {"command": dict(self.task.command), "status": OK} | told | self._strength_info()

    def step(self, action: npt.ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by `control_dt`."""
        if not self._running:
            raise gymnasium.error.ResetNeeded("reset() must be called first, and again once an episode has terminated")
        command, n_clipped = clipped_command(action, self.action_space.shape)
        health = self._engine.advance(self._episode.tension(command[None])[:, 0], self.n_substeps)
        if health.ok:
            self._state = self._engine.state
        else:
            self._engine.restore(self._state)
        motion = Motion.of(self._state)
        scores, over = self._episode.score(motion, np.array([health.ok]))
        self._running = not over[0]
        observation, n_beyond = self._observe()
        if not health.ok:
            # Not before the last sound moment was observed.
            self._episode.n_step += 1
        terms = _first(scores)
        info = {
            "reward_terms": terms,
            "outcome": _first(self.task.outcome(motion, np.zeros(1, dtype=np.int64))),
            "status": str(health),
            "clipped_actions": int(n_clipped),
            "clipped_observations": n_beyond,
        } | self._strength_info()
        return observation, sum(terms.values()), bool(over[0]), False, info

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Picture of the worm now and of the place it is to reach, shape (480, 640, 3); None without a render mode."""
        if self.render_mode is None:
            return None
        return self.picture(self._episode, Motion.of(self._state), 0)

    def picture(self, episodes: Episodes, motion: Motion, worm: int) -> npt.NDArray[np.uint8]:
        """Picture of one of several worms, shape (480, 640, 3), whatever the render mode."""
        if self._renderer is None:
            from lattice_gym.rendering.scene import Renderer

            self._renderer = Renderer(self.lattice, self.model, n_marker=len(episodes.task.markers(worm)))
        caption = episodes.task.caption(motion.rows(np.array([worm])), worm)
        time, activation = float(episodes.time[worm]), episodes.activation[worm, self.groups]
        scene = motion.position[worm], activation, time, caption, motion.bolus_position[worm]
        return self._renderer.update(*scene, episodes.task.markers(worm))

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

    def episodes(self, n_worm: int) -> Episodes:
        """Make episodes of n worms, each as this environment has one."""
        task = type(self.task)(self.lattice, self.control_dt, model=self.model, n_worm=n_worm, **self._given)
        task.rest = self._start
        return self._episodes(task)

    def _episodes(self, task: Task) -> Episodes:
        n_action = int(self.groups.max()) + 1
        observer = Observer(
            self.model, task, n_action, self.observation, self.rhythm, self.adaptation, self._goals_apart
        )
        return Episodes(task, observer, self.design, self.groups, self.adaptation, self.randomisation)

    def _make_engine(self) -> Simulation:
        return simulate(self.engine_name, self._body, self.dt, self.splitting, self.energy_check, self.step_check)

    def _substeps(self, dt: object, allow_large_dt: object) -> tuple[int, float]:
        """Physics steps in a control step, and their length [s]."""
        if not isinstance(allow_large_dt, bool):
            raise ValueError(f"allow_large_dt = {allow_large_dt!r}: must be True or False")
        control_dt, tension, bodies = self.control_dt, self.design.max_tension, [self.model]
        tension *= 1.0 if self.adaptation is None else self.adaptation.most
        if self.randomisation is not None:
            tension *= self.randomisation.strongest
            bodies = self.randomisation.corners(self.model)
        if dt is None:
            step = min(default_dt(body, control_dt, tension) for body in bodies)
        else:
            step = _number("dt", dt, 0.0, control_dt, "s")
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
        if dt is None or allow_large_dt:
            return n_substeps, step
        limit = min(stable_dt(body, tension, self.splitting) for body in bodies)
        if step > limit:
            raise ValueError(f"dt = {step!r}: above the predicted stable {limit:.6g} s; allow_large_dt=True permits it")
        return n_substeps, step

    def _settled(self) -> RodState:
        """State in which an episode starts, at rest: that of the model, after it has settled in its surroundings."""
        state = self.model.rest_state()
        if not self.task.settles:
            return state
        body = replace(self.model, medium_drag=min(self.model.medium_drag, SETTLING_DRAG))
        # Slack muscles damp nothing, whatever their law, and need no shorter step for it.
        step = default_dt(replace(body, hill=None), SETTLING_SPAN, self.design.max_tension)
        engine, start, now, speed = simulate("fused", body, step), state, state, np.inf
        for _ in range(round(LONGEST_SETTLING / SETTLING_SPAN)):
            health, before = engine.advance(np.zeros(self.model.n_muscle), round(SETTLING_SPAN / step)), now
            if not health.ok:
                raise ValueError(f"world: worm and ball do not come to rest in it: {health}")
            now = engine.state
            speed = _speed(before, now) / self.design.height
            start = replace(state, position=now.position, directors=now.directors, bolus_position=now.bolus_position)
            if speed <= QUIET or self.task.over(Motion.of(start))[0]:
                break
        if self.task.over(Motion.of(start))[0]:
            raise ValueError(
                f"world: {self.task.name} is over before it starts: while worm and ball come to rest in it"
            )
        if not speed <= AT_REST:
            raise ValueError(
                f"world: worm and ball do not come to rest in it: after {LONGEST_SETTLING:g} s their largest speed is "
                f"{speed:.3g} heights a second; must be at most {AT_REST:g}"
            )
        return start

    def _strength_info(self) -> dict[str, Any]:
        return {} if self.adaptation is None else {"strength": self.strength}

    def _observe(self) -> tuple[Observation, int]:
        """Observation, and how many of its displacements and velocities lay beyond their bound."""
        observation, n_beyond = self._episode.observe(Motion.of(self._state))
        seen = {name: part[0] for name, part in observation.items()} if self._goals_apart else observation[0]
        return seen, int(n_beyond[0])


def clipped_command(action: npt.ArrayLike, shape: tuple[int, ...]) -> tuple[FloatArray, IntArray]:
    """Commands from 0 to 1, of the given shape (..., n_action), and how many were clipped, shape (...,).

    Raises
    ------
    ValueError
        NaN, another shape or what is no real number.
    """
    try:
        given = np.asarray(action)
    except ValueError:
        raise ValueError(f"action: must be an array of shape {shape}, got {action!r}") from None
    if given.dtype.kind not in "fiu":
        raise ValueError(f"action: must hold real numbers, got {given.dtype}")
    if given.shape != shape:
        raise ValueError(f"action: shape must be {shape}, got {given.shape}")
    command = given.astype(np.float64)
    if given.min() >= 0.0 and given.max() <= 1.0:
        return command, np.zeros(shape[:-1], dtype=np.int64)
    if np.isnan(given).any():
        raise ValueError(f"action: must not be NaN, got NaN in {np.argwhere(np.isnan(given)).tolist()}")
    command = np.minimum(np.maximum(command, 0.0), 1.0)
    return command, (command != given).sum(axis=-1)


def seed_of(seed: object) -> int:
    """Seed as a whole number, or a ValueError."""
    number = whole_number(seed)
    if number is None or number < 0:
        raise ValueError(f"seed = {shown(seed)}: must be None or a whole number, 0 or more")
    return number


def _first(values: Mapping[str, FloatArray]) -> dict[str, float]:
    """Numbers of the first worm."""
    return {name: float(value[0]) for name, value in values.items()}


def _check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{name} = {value!r}: must be one of {', '.join(choices)}")


def _number(name: str, value: object, low: float, high: float, unit: str) -> float:
    """Positive number within bounds."""
    if is_number(value) and value > 0.0 and low <= value <= high:
        return float(value)
    raise ValueError(f"{name} = {value!r}: must be a number from {low:g} to {high:g} [{unit}], and not 0")


def _design(design: object, own: Mapping[str, Any]) -> LatticeDesign:
    if isinstance(design, LatticeDesign):
        return design
    if design is None or isinstance(design, Mapping):
        return LatticeDesign.from_dict({**own, **(design or {})})
    raise ValueError(f"design = {design!r}: must be a LatticeDesign, its dict form or None")


def _world(world: object, own: Callable[[Lattice], World], lattice: Lattice) -> World:
    if isinstance(world, World):
        return world
    if world is None or isinstance(world, Mapping):
        given, around = dict(world or {}), own(lattice)
        for name, part in vars(around).items():
            if isinstance(part, Part) and isinstance(given.get(name), Mapping):
                given[name] = {**asdict(part), **given[name]}
        return World.from_dict({**vars(around), **given})
    raise ValueError(f"world = {shown(world)}: must be a World, its dict form or None")


def _speed(before: RodState, now: RodState) -> float:
    """Largest speed of a node or ball [m/s]: that of now or the mean since a state SETTLING_SPAN ago."""
    nodes = now.velocity, (now.position - before.position) / SETTLING_SPAN
    balls = now.bolus_velocity, (now.bolus_position - before.bolus_position) / SETTLING_SPAN
    return max(float(np.linalg.norm(part, axis=1).max(initial=0.0)) for part in (*nodes, *balls))
