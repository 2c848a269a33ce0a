"""What is observed of worms: a list of named terms, one after the other, within finite bounds."""

from __future__ import annotations

from collections.abc import Sequence
from inspect import getdoc
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from lattice_gym.checks import FloatArray, IntArray, invalid_value, is_list, subclass
from lattice_gym.envs.terms import TERMS, ObservationTerm
from lattice_gym.tasks.base import COMMAND_BOUND, GoalTask, Task

if TYPE_CHECKING:
    from lattice_gym.envs.core import Worms
    from lattice_gym.envs.scene import Scene

Observation = Any
"""An array; of a worm with goals a dict of three."""
TermLike = str | type[ObservationTerm]
"""A term's name, "module:Class", or the class itself."""


def resolve_terms(observation: object, scene: Scene) -> tuple[type[ObservationTerm], ...]:
    """Classes of the terms that are asked for; None: those of the task, and clock and strength where given.

    Of the scene only `task_class`, `goals_apart`, `rhythm` and `adaptation` are read.

    Raises
    ------
    ValueError
        What is no list of different terms, or lacks one for what was asked to be observed by another argument.
    """
    given = {"clock": scene.rhythm is not None, "strength": scene.adaptation is not None and scene.adaptation.observed}
    further = [name for name, wanted in given.items() if wanted]
    own = [term for term in scene.task_class.observation if term != "command" or not scene.goals_apart]
    default = own + [name for name in further if name not in own]
    if observation is None:
        observation = default
    if not is_list(observation) or len(observation) == 0:
        first = [observation] if isinstance(observation, str) and observation in TERMS else default[:1]
        example = str([*first, *default[1:]]).replace("'", '"')
        raise invalid_value("observation", observation, f"must be a list of terms; write {example}")
    terms = tuple(
        subclass(f"observation[{place}]", term, ObservationTerm, TERMS)  # type: ignore[type-abstract]
        for place, term in enumerate(observation)
    )
    for place, term in enumerate(terms):
        missing = [] if isinstance(getattr(term, "name", None), str) else ["name"]
        if missing := missing + sorted(term.__abstractmethods__):
            raise invalid_value(f"observation[{place}]", term, f"lacks {', '.join(missing)}")
    names = [term.name for term in terms]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"observation: holds {name!r} twice")
    for name in further:
        if name not in names:
            why = f"rhythm = {scene.rhythm:g}" if name == "clock" else "adaptation.observed = True"
            raise ValueError(f'{why}: is not observed; add "{name}" to observation')
    return terms


OWN_TERMS = frozenset(TERMS.values())


class Observer:
    """Observes worms side by side.

    Parameters
    ----------
    scene
        What they have in common; `scene.term_classes` are observed.
    task
        What is asked of them.

    Attributes
    ----------
    terms : tuple of ObservationTerm
        In their order.
    slices : dict
        Where each term stands in the flat observation, by name.
    space : Space
        Of one worm's observations.

    """

    def __init__(self, scene: Scene, task: Task) -> None:
        self.terms = tuple(_build_term(term, scene) for term in scene.term_classes)
        ends = np.cumsum([0, *(term.size for term in self.terms)]).tolist()
        self.slices = {term.name: slice(*ends[place : place + 2]) for place, term in enumerate(self.terms)}
        self._goals = task if scene.goals_apart and isinstance(task, GoalTask) else None
        low, high = (np.concatenate([getattr(term, end) for term in self.terms]) for end in ("low", "high"))
        flat = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        self.space: spaces.Space[Any] = flat
        if self._goals is not None:
            goal = spaces.Box(-COMMAND_BOUND, COMMAND_BOUND, (self._goals.n_goal,), np.float32)
            self.space = spaces.Dict({"observation": flat, "achieved_goal": goal, "desired_goal": goal})

    def __call__(self, worms: Worms) -> tuple[Observation, IntArray]:
        """Observations of all worms, and how many numbers of each were clipped, shape (n_worm,)."""
        n_clipped, parts = np.zeros(worms.n_worm, dtype=np.int64), []
        for term in self.terms:
            values = term(worms)
            if type(term) not in OWN_TERMS:
                _check_shape(term, values, worms.n_worm)
            if not term.stays_within:
                values, beyond = _clip(term, values)
                n_clipped += beyond
            parts.append(values)
        flat: npt.NDArray[np.float32] = np.concatenate(parts, axis=-1, dtype=np.float32)
        if self._goals is None:
            return flat, n_clipped
        goals = {"achieved_goal": self._goals.achieved(worms.motion), "desired_goal": self._goals.desired()}
        return {"observation": flat, **goals}, n_clipped


def table(terms: Sequence[ObservationTerm]) -> str:
    """Markdown table of terms: name, size, unit, bounds and meaning."""
    rows = ["| term | numbers | unit | bounds | what |", "|---|---|---|---|---|"]
    for term in terms:
        spans = dict.fromkeys(f"{low:g} to {high:g}" for low, high in zip(term.low, term.high, strict=True))
        meaning = " ".join((getdoc(type(term)) or "").split())
        rows.append(f"| `{term.name}` | {term.size} | {term.unit} | {', '.join(spans)} | {meaning} |")
    return "\n".join(rows) + "\n"


def _build_term(kind: type[ObservationTerm], scene: Scene) -> ObservationTerm:
    """Term of a scene, whose bounds are sound."""
    term = kind(scene)
    low, high = (np.asarray(getattr(term, end, None)) for end in ("low", "high"))
    shaped = low.dtype.kind in "fiu" and low.ndim == 1 and low.shape == high.shape
    with np.errstate(over="ignore"):  # What float32 cannot hold becomes infinite, and is refused.
        sound = shaped and high.dtype.kind in "fiu" and np.isfinite(np.array([low, high], dtype=np.float32)).all()
    if not (sound and (low <= high).all()):
        raise ValueError(
            f"{kind.__name__}: low and high must be arrays of one shape (size,), finite as float32, low <= high"
        )
    return term


def _check_shape(term: ObservationTerm, values: FloatArray, n_worm: int) -> None:
    """Refuse what a term from outside gives unless it is one row a worm."""
    if np.shape(values) != (n_worm, term.size):
        raise ValueError(f"{term.name}: must give shape {(n_worm, term.size)}, got {np.shape(values)}")


def _clip(term: ObservationTerm, values: FloatArray) -> tuple[FloatArray, IntArray | int]:
    """Values of a term within its bounds, and how many of each worm were not."""
    if ((values >= term.low) & (values <= term.high)).all():
        return values, 0
    if np.isnan(values).any():
        raise ValueError(f"{term.name}: gives NaN")
    bounded = np.minimum(np.maximum(values, term.low), term.high)
    return bounded, (bounded != values).sum(axis=-1)
