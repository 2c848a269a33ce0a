"""What an environment's arguments come to, before anything moves: body, muscles, world, time step, start."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Any, TypeVar, cast, get_args

import numpy as np
from gymnasium import spaces

from lattice_gym.body.design import LatticeDesign
from lattice_gym.body.lattice import Lattice, build_lattice
from lattice_gym.body.muscles import MuscleLayout, control_groups, resolve_layout
from lattice_gym.checks import FloatArray, IntArray, Parameters, choice, flag, instance, invalid_value, number, optional
from lattice_gym.engines.registry import ENGINES, EngineName
from lattice_gym.envs.actions import COMMAND_RANGE, resolve_action_range
from lattice_gym.envs.fidelity import FidelityName, named_fidelity
from lattice_gym.envs.observation import TermLike, resolve_terms
from lattice_gym.envs.randomisation import Randomisation
from lattice_gym.envs.settling import settle
from lattice_gym.physics.critical_step import critical_dt, default_dt
from lattice_gym.physics.laws.activation import Activation, resolve_activation
from lattice_gym.physics.laws.adaptation import Adaptation
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.world import World
from lattice_gym.physics.worm import build_model
from lattice_gym.tasks.base import CommandValues, GoalTask, Task
from lattice_gym.tasks.registry import TASKS, resolve_task

Init = TypeVar("Init", bound=Callable[..., None])

MIN_CONTROL_DT, MAX_CONTROL_DT = 1e-6, 1e3
"""Bounds of the control step [s]."""
MAX_SUBSTEPS = 1_000_000
"""Largest number of physics steps in a control step; more are a mistake in dt."""
DIVISION_TOLERANCE = 1e-9
"""A control step is a whole number of physics steps if that many differ from it by no more than this share."""


class Scene:
    """All that worms of one environment have in common; nothing in it moves.

    Parameters
    ----------
    task
        As of `LatticeWormEnv`, which documents them all; None: the first that fits.
    goals_apart
        Whether goals are observed apart, which only a `GoalTask` has.

    Attributes
    ----------
    task_class : type of Task
        What is asked of the worms.
    design, lattice, layout, world, model
        The body, its muscles, what surrounds it, and the assembly of all of it.
    groups : array
        Control group of every active muscle, shape (n_muscle,).
    n_group : int
        Number of control groups, that is of numbers in an action.
    action_range : tuple of float
        Least and largest number of an action, which stand for the commands 0 and 1.
    action_space : Box
        Of one worm's actions.
    control_dt, dt : float
        Time between actions and time step of the physics [s].
    n_substeps : int
        Physics steps in a control step.
    start : RodState
        In which episodes start.
    term_classes : tuple of types
        What is observed, in order.
    activation_law : Activation
        How activations follow commands.
    adaptation, randomisation, rhythm, engine_name, splitting, energy_check, step_check
        As given, with defaults filled in.

    Raises
    ------
    ValueError
        An argument that cannot be used; it is named.

    """

    def __init__(
        self,
        task: str | type[Task] | None = None,
        design: LatticeDesign | Mapping[str, Any] | None = None,
        muscles: str | MuscleLayout | Mapping[str, Any] | None = None,
        control: str | Sequence[int] | IntArray = "muscle",
        action_range: Sequence[float] | FloatArray = COMMAND_RANGE,
        rhythm: float | None = None,
        fidelity: FidelityName = "default",
        splitting: Splitting | None = None,
        engine: EngineName = "fused",
        dt: float | None = None,
        allow_large_dt: bool = False,
        energy_check: bool = False,
        step_check: bool = False,
        control_dt: float = 0.05,
        observation: Sequence[TermLike] | None = None,
        command: CommandValues | None = None,
        world: World | Mapping[str, Any] | None = None,
        adaptation: Adaptation | Mapping[str, Any] | None = None,
        hill: Hill | Mapping[str, Any] | None = None,
        randomise: Mapping[str, Sequence[float]] | None = None,
        reward_weights: Mapping[str, float] | None = None,
        time_limit: int | None = None,
        activation: Activation | str | Mapping[str, Any] | None = None,
        *,
        goals_apart: bool = False,
    ) -> None:
        self.task_class, self.goals_apart = _task(task, goals_apart), goals_apart
        self.engine_name = choice("engine", engine, ENGINES)
        self.energy_check, self.step_check = flag("energy_check", energy_check), flag("step_check", step_check)
        self.control_dt = number("control_dt", control_dt, MIN_CONTROL_DT, MAX_CONTROL_DT, "s")
        self.rhythm = optional(number, "rhythm", rhythm, 0.0, 0.5 / self.control_dt, "Hz", above=True)
        preset = named_fidelity(fidelity)
        self.design = preset.remesh(_design(design, self.task_class.design))
        self.lattice = build_lattice(self.design)
        self.layout = self._own_muscles() if muscles is None else resolve_layout(muscles, self.lattice)
        self.groups = control_groups(control, self.layout, self.lattice)
        self.n_group = int(self.groups.max()) + 1
        self.action_range = resolve_action_range(action_range)
        self.action_space = spaces.Box(*self.action_range, (self.n_group,), np.float32)
        self.world = resolve_world(world, self.task_class.world, self.lattice)
        if self.world.lying and self.design.base == "clamped":
            raise ValueError("world: a worm that lies needs a free base (design.base); on a clamped one it stands")
        self.adaptation = Adaptation.resolve("adaptation", adaptation)
        self.activation_law = resolve_activation(activation, self.design)
        self.randomisation = Randomisation.resolve(randomise)
        self.term_classes = resolve_terms(observation, self)
        self.model = build_model(self.lattice, self.layout, self.world, hill=Hill.resolve("hill", hill))
        self._task_arguments: dict[str, Any] = {
            "command": command,
            "reward_weights": reward_weights,
            "time_limit": time_limit,
        }
        first = self.make_task(1)
        preferred: Splitting = "pyelastica" if self.engine_name == "pyelastica" else preset.splitting
        self.splitting: Splitting = optional(choice, "splitting", splitting, get_args(Splitting)) or preferred
        self.n_substeps, self.dt = self._substeps(dt, flag("allow_large_dt", allow_large_dt))
        self.start = settle(first, self.model, self.layout)

    def make_task(self, n_worm: int) -> Task:
        """Task of so many worms; its `rest` is that of the model until it is given the state that episodes start in."""
        return self.task_class(self.lattice, self.control_dt, model=self.model, n_worm=n_worm, **self._task_arguments)

    def _own_muscles(self) -> MuscleLayout:
        """Muscles that the task is meant for."""
        label, own = f"{self.task_class.__name__}.muscles", self.task_class.muscles(self.lattice)
        return instance(label, own, MuscleLayout, "; return one, or leave the method out")

    def _substeps(self, dt: object, allow_large_dt: bool) -> tuple[int, float]:
        """Physics steps in a control step, and their length [s]."""
        control_dt, tension, bodies = self.control_dt, self.design.max_tension, [self.model]
        tension *= 1.0 if self.adaptation is None else self.adaptation.max_strength
        if self.randomisation is not None:
            tension *= self.randomisation.max_tension_factor
            bodies = self.randomisation.corners(self.model)
        if dt is None:
            step = min(default_dt(body, control_dt, tension) for body in bodies)
        else:
            step = number("dt", dt, 0.0, control_dt, "s", above=True)
        ratio = control_dt / step
        if ratio > MAX_SUBSTEPS:
            must = f"{ratio:.3g} steps in control_dt = {control_dt:g} s, at most {MAX_SUBSTEPS}"
            raise invalid_value("dt", step, must)
        n_substeps = round(ratio)
        if abs(n_substeps * step - control_dt) > DIVISION_TOLERANCE * control_dt:
            nearest = f"{control_dt / (int(ratio) + 1)!r} and {control_dt / int(ratio)!r}"
            raise invalid_value(
                "dt", step, f"must divide control_dt = {control_dt!r} s; the nearest that do: {nearest} s"
            )
        if dt is None or allow_large_dt:
            return n_substeps, step
        critical = min(critical_dt(body, tension, self.splitting) for body in bodies)
        if step > critical:
            raise invalid_value(
                "dt", step, f"above the critical time step, {critical:.6g} s; allow_large_dt=True permits it"
            )
        return n_substeps, step


class UnknownArgumentError(TypeError, ValueError):
    """A keyword that is no argument: a TypeError as Python's own, by whose words some libraries try keywords out.

    And a ValueError, as is whatever else cannot be used.
    """


def takes_scene_arguments(init: Init) -> Init:
    """Let the `**arguments` of a constructor be those of `Scene`: named in its signature, and any other refused."""
    own = list(signature(init).parameters.values())[:-1]
    further = [parameter.replace(kind=Parameter.KEYWORD_ONLY) for parameter in signature(Scene).parameters.values()]
    taken = {parameter.name for parameter in own} | {"goals_apart"}
    known = [*own, *(parameter for parameter in further if parameter.name not in taken)]
    argument_names = [parameter.name for parameter in known[1:]]

    @wraps(init)
    def checked(self: object, *args: Any, **arguments: Any) -> None:
        for name in arguments:
            if name not in argument_names:
                raise UnknownArgumentError(
                    f"got an unexpected keyword argument {name!r}; there are {', '.join(argument_names)}"
                )
        init(self, *args, **arguments)

    checked.__signature__ = Signature(known)  # type: ignore[attr-defined]
    return cast(Init, checked)


def resolve_world(world: object, own: Callable[[Lattice], World], lattice: Lattice) -> World:
    """World as given, or a task's own with what a dict changes of it; anything else is a ValueError."""
    if world is None or isinstance(world, Mapping):
        given, around = dict(world or {}), own(lattice)
        for name, part in vars(around).items():
            if isinstance(part, Parameters) and isinstance(given.get(name), Mapping):
                given[name] = {**part.to_dict(), **given[name]}
        return World.from_dict({**vars(around), **given})
    return instance("world", world, World, ", its dict form or None")


def _task(task: str | type[Task] | None, goals_apart: bool) -> type[Task]:
    """Task as `resolve_task` finds it; where goals are observed apart one that has some."""
    if task is None:
        task = "reach" if goals_apart else "peristalsis"
    kind = resolve_task(task)
    if goals_apart and not issubclass(kind, GoalTask):
        having = ", ".join(name for name, known in TASKS.items() if issubclass(known, GoalTask))
        raise invalid_value("task", task, f"has no goals; those that do: {having}")
    return kind


def _design(design: object, own: Mapping[str, Any]) -> LatticeDesign:
    if design is None or isinstance(design, Mapping):
        return LatticeDesign.from_dict({**own, **(design or {})})
    return instance("design", design, LatticeDesign, ", its dict form or None")
