"""The Gymnasium environment of one worm; its docstring is the specification of all of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from lattice_gym.body.design import LatticeDesign
from lattice_gym.checks import FloatArray, choice, optional, whole
from lattice_gym.envs.actions import to_command
from lattice_gym.envs.attributes import SceneAttributes
from lattice_gym.envs.core import Worms
from lattice_gym.envs.info import worm_info
from lattice_gym.envs.observation import Observation
from lattice_gym.envs.pictures import RENDER_MODES, Pictures
from lattice_gym.envs.pitfalls import warn_of_pitfalls
from lattice_gym.envs.registration import warn_of_time_limit
from lattice_gym.envs.scene import Scene, takes_scene_arguments
from lattice_gym.physics.state import RodState
from lattice_gym.tasks.base import Task

METADATA: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 20.0}


class LatticeWormEnv(SceneAttributes, gymnasium.Env[Observation, npt.NDArray[np.float32]]):
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

    `Box(0, 1, (n_action,), float32)`: one command per control group, by default one per muscle. `action_range=(-1, 1)`
    makes it `Box(-1, 1)`, whose -1 is the command 0; see there when to use it.

    | `control` | groups | n_action for "all" muscles of the default design |
    |---|---|---|
    | "muscle" | every active muscle | 90 |
    | "ring" | level (a vertical muscle's lower one) and orientation; alike all round, so it cannot bend | 15 |
    | "column" | azimuth of the muscle's middle and orientation | 24 |
    | sequence of n_muscle whole numbers | any partition: the group of each muscle | number of groups |

    Numbers outside the range are clipped and counted in `info["clipped_actions"]`. NaN, another shape or what is no
    real number is a ValueError. All else that is told is in commands from 0 to 1, whatever the range of actions: gaits,
    the observed "previous_action" and `worms.previous_action`; `action_of` gives the action of a command.

    An action stands for the command u of first-order activation dynamics, da/dt = (u - a) / tau with the design's rise
    time where u > a and else its decay time, solved exactly over the control step; `activation` has other laws. Within
    the step both engines take the tension as linear in time, from max_tension times the activation at its start to that
    at its end. With `hill` the muscle's length and speed then multiply it, in every element and physics step; with
    `adaptation` its strength does.

    ## Observation space

    `Box(float32)`, flat, with finite bounds: the terms that `observation` lists, in that order, by default
    ["sites", "activation", "command"], then "clock" with a `rhythm` and "strength" with an observed `adaptation`.
    `observation_slices` tells where each stands.

    | term | what it is | count | unit | bound |
    |---|---|---|---|---|
    | "sites" | displacement from rest of each site (x, y, z), then velocity of each | 6 n_point | see below | +-20 |
    | "nodes" | the same of each node of the structure rods | 6 n_point | see below | +-20 |
    | "activation" | of each control group: its muscles share one | n_action | 1 | 0 to 1 |
    | "command" | what the task commands, see below | 0 to 7 | | |
    | "clock" | cosine and sine of a clock that starts with the episode; needs `rhythm` | 2 | 1 | +-1 |
    | "strength" | of each muscle; needs `adaptation` | n_muscle | that of the design | 0 to its cap |
    | "muscle_lengths" | of each muscle | n_muscle | rest length | 0 to 5 |
    | "muscle_rates" | how fast each muscle grows longer | n_muscle | rest length / s | +-20 |
    | "ring_radii" | mean radius of the ring at each level | n_level | that at rest | 0 to 10 |
    | "body_frame" | top: centre less the base's, normal, velocity | 9 | body lengths, 1, body lengths / s | 20, 1, 20 |
    | | of a free base, before it: centre less that at the start, normal, velocity | 9 | the same | the same |
    | "ground_contact" | 1 for a site that touches the ground, else 0; needs one | n_site | 1 | 0 to 1 |
    | "previous_action" | the command of each group, as clipped, 0 at the start | n_action | 1 | 0 to 1 |
    | "module:Class" | an `ObservationTerm` of your own; the class itself is taken too | its own | its own | its own |

    Points are the sites (each the mean of its two nodes) or the nodes, without those that the base holds in place: 48
    or 480 in the default design. Displacements are in units of 0.2 body lengths, velocities of body lengths a second.
    What lies beyond its bound is clipped to it and counted in `info["clipped_observations"]`; of sites and nodes of the
    default design none come near. Of a worm that crawls, displacements in x and y are less their mean over the points.
    A ball is observed in transport only, and its spin never. `docs/observations.md` has sizes and an example of a term.

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
    `LatticeWormVectorEnv`, which `gymnasium.make_vec` makes. `worms` holds what either has and a wrapper may want:
    `motion`, `measures` (lengths, radii, centres and more), `activation`, `strength`, `previous_action`, `time`,
    `task`, `state()` and `health()`, a row a worm; see `Worms`.

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
    | reach | `approach` | distance of the target from the top's centre at rest, less that now [body lengths] |
    | crawl | `progress` | 10 times the centre of mass's way along the command in this step [body lengths] |
    | transport | `progress` | 10 times the ball's way in the body along the command in this step [body lengths] |
    | transport | `lost` | -5 where the ball has left the body other than by the commanded end, else 0 |
    | all | `effort` | minus 0.01 times the mean squared activation of the muscles |
    | all | `divergence` | 0; or -1000 where the physics diverged, and then all other terms are 0 |

    Numbers here, signs aside, are weights, 1 where there is none: `reward_weights` changes them. The penalty of a
    divergence is then `task.penalty`: 1000, or more where that is less than the terms can differ by in an episode of
    `time_limit` steps.

    With d the deviation of each ring's radius from rest and t the commanded one, as shares of the rest radius, and sums
    over the n levels that can move, tracking = (sum t^2 - sum (d - t)^2) / (n amplitude^2 / 2 + sum (d - t)^2): 0 for
    doing nothing, sum t^2 / (n amplitude^2 / 2) for following perfectly, which is 1 on average, and never below -1.

    The ball's place in the body is its projection on the centreline, which runs from ring centre to ring centre, in
    lengths at rest. It has left by an end where it lies beyond the plane through the last ring's centre normal to that
    line, and sideways where it is further from the line than the radius of the rings there
    (`measures.centreline_projection`).

    Bend, azimuth and strain are relative to the base: under a free body, to its bottom ring, so that a rigid motion of
    the whole body is neither bend nor strain.

    ## Starting state

    At rest, free of stress, activations 0, strengths 1 unless an `adaptation` carries them. In crawl and transport worm
    and ball came to rest first, with slack muscles, and displacements count from there: until none of their points was
    faster than 0.0001 body lengths a second, for 30 s at most, in a medium of at most 0.05 N s/m^2, as drag only delays
    it there. What is then faster than 0.001, or has left the body, is a ValueError. In other tasks a worm with weight
    sags from the start, and that counts. Only the command is random, uniform over the ranges below. Numbers given as
    `command` are held in every episode, those in `reset(options={...})` in that one; the options win. Of a list or
    NumPy array in place of a number, one is drawn for each episode.

    | task | name | drawn from | may be given |
    |---|---|---|---|
    | bending | `azimuth` [rad] | 0 to 2 pi | -2 pi to 2 pi |
    | peristalsis | `speed` [m/s], up > 0 | 0.8 to 1.2 body lengths / s | 0.1 to 10 body lengths / s, up or down |
    | peristalsis | `wavelength` [m] | 0.8 to 1.2 body lengths | 3 level spacings to 10 body lengths |
    | peristalsis | `amplitude` over the rest radius | 0.04 to 0.07 | 0.001 to 0.5 |
    | peristalsis | `phase` at the base at the start [rad] | 0 to 2 pi | -2 pi to 2 pi |
    | reach | `azimuth` of the target [rad] | 0 to 2 pi | -2 pi to 2 pi |
    | reach | `radius`: its distance from the axis [body lengths] | 0.05 to 0.2 | 0 to 1.5 |
    | reach | `rise`: its height above the top at rest [body lengths] | -0.08 to 0 | -1 to 1.5 |
    | crawl | `direction` along x | -1 or 1 | -1 or 1 |
    | transport | `direction` up the body | -1 or 1 | -1 or 1 |

    A period of the wave must last at least 4 control steps. `tasks.reach.EIGHT_TARGETS` is a command of reach: eight
    targets on a circle, as in Schaffer et al. (arXiv 2408.16069).

    ## Episode end

    `terminated` in transport where the ball has left the body, and else only where the physics diverges: a state that
    is not finite, an element inverted or over-stretched, a joint torn or, where asked for, spurious energy
    (`energy_check`) or too long a step (`step_check`). Then `info` tells what and where, see below, and the observation
    is the last sound one, again; `time` is that of the control step that failed. The penalty exceeds what lies between
    the best and the worst episode of at most `time_limit` steps, so none of these that ends well is worth less; a
    longer one warns where it may be. The environment never truncates itself: the time limit is registered.

    ## Info

    After a reset and after every step the same names, and nothing but numbers: `command`, `reward_terms`, `outcome`
    (names to floats), `status`, `rod`, `element`, `joint`, `clipped_actions`, `clipped_observations` (whole numbers).
    With an `adaptation` also `strength`, that of every active muscle over the design's, shape (n_muscle,); with
    `randomise` the `factors` drawn for the episode, by name; that of "strength" has shape (n_muscle,).

    | `status` | `lattice_gym.Status` | what went wrong in the step |
    |---|---|---|
    | 0 | `OK` | nothing |
    | 1 | `NON_FINITE` | a position, velocity or director is NaN or infinite |
    | 2 | `OVERSTRETCHED` | an element, or a muscle that is a line, is far too short or long |
    | 3 | `INVERTED` | an element points backwards |
    | 4 | `TORN` | two joined nodes have come off each other |
    | 5 | `ENERGY` | spurious energy, with `energy_check` |
    | 6 | `INACCURATE` | the time step was too long, with `step_check` |

    `rod`, `element` and `joint` say where, as indices of `model`, -1 where there is none: a failure without a rod is
    the ball's. `lattice_gym.describe_status(info, env)` says it in words.

    | task | `outcome`, which is not the reward |
    |---|---|
    | extension, compression | `strain` |
    | bending | `bend_angle` [rad], `bend_direction` (azimuth) [rad] |
    | peristalsis | `wave_index` (1 is a pure travelling wave, 0 a standing one, noise or none) |
    | peristalsis | `wave_direction` (+1 up, -1 down, 0 neither), `wave_speed` [m/s] |
    | peristalsis | `wave_amplitude` over the rest radius: of the dominant mode, wave or not |
    | reach | `distance` of the top's centre from the target [m] |
    | reach | `reached`: 1 once it came within 0.03 body lengths, else 0; `reach_time`: when it first did [s], else 0 |
    | crawl | `speed` along the command since the start [body lengths a minute] |
    | crawl | `drift`: angle between the way so far and the command [rad]; 0 before 0.01 body lengths |
    | crawl | `cost_of_transport`, see below; 0 before 0.01 body lengths along the command |
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
    "fine": sites, and so observations, are the same on all. With "nodes" observed they are not. A mesh that a
    fidelity sets has the damping per length of the design's own.

    Arguments
    ---------
    Only `task` and `design` may be given without their names. Where None is all there is to say, it is the default.

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
        How actions drive muscles, see above; "muscle" by default.
    action_range
        Least and largest number of an action, which stand for the commands 0 and 1; (0, 1) by default. Take (-1, 1) for
        a learner whose actions are at first drawn around 0 with a spread of 1 and then clipped, as by PPO, A2C and
        TRPO of most libraries: on (0, 1) that clips two thirds of the first commands, half of them to 0, on (-1, 1) a
        third. SAC, TD3 and others that scale their actions to the space need nothing, nor does `sb3.WormVecEnv`, whose
        actions lie in [-1, 1] anyhow.
    rhythm
        Frequency of the observed clock [Hz], at most half the control rate; None: no clock.
    fidelity
        "fast", "default" (by default) or "fine": mesh and damping, see above.
    splitting
        When velocities are damped: "symmetric", all along the kick (second order in `dt`, fused engine only), or
        "pyelastica", all of it after (first order); None: as the fidelity says, or as the pyelastica engine must.
    engine
        "fused" (by default) or "pyelastica".
    dt
        Physics time step [s], a whole fraction of `control_dt`; None: the largest one below `critical_step.DT_MARGIN`
        of the critical time step.
    allow_large_dt
        Take a `dt` above the critical time step; False by default.
    energy_check
        Keep an energy ledger of every control step, and end an episode with spurious energy; False by default. The law
        of rods that shear and stretch at once has no potential: a violent snap may be flagged whatever the step.
    step_check
        Step doubling: run at half the step too, and end an episode where both differ by more than
        `step_doubling.STEP_TOLERANCE` of the longest side; False by default. It is the only check that catches runs
        which are wrong but smooth, as near a snap, and costs three times the computing. A pickled environment starts
        the comparison anew.
    control_dt
        Time between actions [s]; 0.05 by default.
    observation
        List of terms, see above; None: the default ones.
    command
        Commanded numbers, by name, to hold in every episode, or lists or arrays to draw one from for each.
    world
        Medium, ground and ball around the worm and whether it lies: a World, or a dict of what differs from the task's
        own; None: the task's own, nothing at all for most. A part given as a dict changes the task's own part, or where
        that has none the default one; an object replaces it, and warns where it drops values of the task's; None takes
        it away. One that lies needs a free base, crawl lies on a ground under gravity, and in crawl and transport worm
        and ball must come to rest in it.
    reward_weights
        Weights of reward terms by name in place of the task's own, "effort" among them: {"effort": 0.02}. The penalty
        of a divergence rises with them.
    time_limit
        Most control steps that an episode may last, where those are more than the task's: the penalty of a divergence
        rises with them. It ends nothing: give it with `gymnasium.make(..., max_episode_steps=...)`, of which the
        environment is not told. None: the task's own; in a batch `max_episode_steps`, which is told.
    render_mode
        None or "rgb_array".
    adaptation
        `adaptation.Adaptation` or its dict form: how use changes the strength of each muscle, updated after every
        control step from its mean activation, its mean tension (before the factors of `hill`) and its strain at the
        end. None: not at all. The default `dt` is that for the largest strength there can be.
    activation
        How activations follow commands: None or "first_order" as above; "thelen", whose time constants depend on the
        activation (Thelen 2003); "twitch", critically damped and of second order; or a dict of "law", such a name, and
        its times. A law of your own is an `Activation`: the object, or its class as "module:Class".
    hill
        `hill.Hill` or its dict form: how the force of each muscle depends on its length and speed. None: not at all.
    randomise
        Factors that are drawn for every episode, after its command, uniformly from ranges: a mapping of names to pairs
        (low, high) from 0.01 to 100. "structure_youngs_modulus" and "muscle_youngs_modulus" (with the shear moduli),
        "damping" (of all rods, rotational too, not that of joints or a medium), "max_tension", and "strength", one for
        each muscle. The default `dt` is the smallest at any corner of the ranges and the largest tension; episodes
        start from the state at rest of the design itself, which after settling another body leaves slowly. Nothing of
        it is observed. None: every worm is as designed.

    An argument that cannot be used is a ValueError that names it. With dict forms, and with objects too (but not with
    classes), an EnvSpec survives JSON and makes an equal environment. NumPy numbers and arrays are taken too, but JSON
    knows only plain ones: where a spec is to be written, give `.item()` or `.tolist()` of them. Pickles and deep copies
    go on exactly where the original stood.

    Version history
    ---------------
    v0: first version.
    """

    metadata = METADATA
    _goals_apart: ClassVar[bool] = False
    """Whether goals are observed apart."""
    action_space: spaces.Box[np.float32]
    observation_space: spaces.Space[Any]

    @takes_scene_arguments
    def __init__(
        self,
        task: str | type[Task] | None = None,
        design: LatticeDesign | Mapping[str, Any] | None = None,
        *,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        self.render_mode = optional(choice, "render_mode", render_mode, RENDER_MODES)
        arguments |= {"task": task, "design": design, "goals_apart": self._goals_apart}
        self.scene = scene = Scene(**arguments)
        warn_of_pitfalls(scene, arguments)
        self.worms = Worms(scene, keep_state=True)
        self.metadata = {**METADATA, "render_fps": 1.0 / self.control_dt}
        self.action_space = scene.action_space
        self.observation_space = self.worms.observer.space
        self._pictures = Pictures(self.worms)
        self._running = False

    @property
    def state(self) -> RodState:
        """Copy of the state of all rods, as of the last sound moment."""
        return self.worms.state()

    @property
    def activation(self) -> FloatArray:
        """Activation of every active muscle now, shape (n_muscle,), in [0, 1]."""
        activation: FloatArray = self.worms.activation[0]
        return activation

    @property
    def strength(self) -> FloatArray:
        """Strength of every active muscle now, over that of the design, shape (n_muscle,)."""
        strength: FloatArray = self.worms.strength[0].copy()
        return strength

    @property
    def time(self) -> float:
        """Time since the episode began [s], at the end of the last control step, be it one that failed."""
        return float(self.worms.time[0])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode at rest; options hold commanded numbers, by name, for this episode."""
        seed = optional(whole, "seed", seed, 0)
        self.worms.task.check(options)  # Before the generator is seeded: a refused reset changes nothing.
        self.worms.engine.require_idle()
        super().reset(seed=seed)
        warn_of_time_limit(self.spec, self.scene.task_class, int(self.worms.n_step[0]))
        self.worms.begin(0, self.np_random, options)
        self._running = True
        observation, n_beyond = self._observe()
        return observation, self._info(dict.fromkeys(self.worms.reward_names, 0.0), 0, n_beyond)

    def step(self, action: npt.ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by `control_dt`."""
        if not self._running:
            raise gymnasium.error.ResetNeeded("reset() must be called first, and again once an episode has terminated")
        worms = self.worms
        command, n_clipped = to_command(action, self.action_space.shape, self.scene.action_range)
        result = worms.step(command[None])
        terminated = bool(result.terminated[0])
        self._running = not terminated
        observation, n_beyond = self._observe()
        info = self._info(_first(result.terms), int(n_clipped), n_beyond)
        return observation, result.reward.item(0), terminated, False, info

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Picture of the worm now and of the place it is to reach, shape (480, 640, 3); None without a render mode.

        Any thread may ask. A fork of a process that has drawn gets a RuntimeError; one started by spawn gets a picture.
        """
        return None if self.render_mode is None else self._pictures.draw()

    def close(self) -> None:
        """Free the renderer and threads."""
        warn_of_time_limit(self.spec, self.scene.task_class, int(self.worms.n_step[0]))
        self._pictures.close()
        self.worms.close()

    def _info(self, terms: dict[str, float], n_clipped: int, n_beyond: int) -> dict[str, Any]:
        """Info of the step or of the start: the same names, and arrays of the same shapes."""
        info = worm_info(self.worms)
        info["reward_terms"], info["outcome"] = terms, _first(self.worms.outcome())
        info["clipped_actions"], info["clipped_observations"] = n_clipped, n_beyond
        return info

    def _observe(self) -> tuple[Observation, int]:
        """Observation, and how many of its numbers were clipped."""
        seen, n_beyond = self.worms.observe()
        one = {name: part[0] for name, part in seen.items()} if self._goals_apart else seen[0]
        return one, int(n_beyond[0])


def _first(values: Mapping[str, FloatArray]) -> dict[str, float]:
    """Numbers of the first worm."""
    return {name: float(value.item(0)) for name, value in values.items()}
