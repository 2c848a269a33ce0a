"""The cases of the stability report: a grid around the default design, and random designs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lattice_gym.body.design import LatticeDesign
from lattice_gym.physics.laws.ball import Ball
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.medium import Medium
from lattice_gym.physics.world import World

PAIRS_AND_PERIODS = ((2, 1.0), (2, 2 / 3), (3, 2.0), (3, 1.5), (3, 1.0), (4, 2.0), (4, 1.6), (6, 1.5))
"""Pairs of rods and period ratios that close, with 2 to 8 segments on a rod, for random designs."""
GRID: dict[str, dict[str, tuple[float, ...]]] = {
    "stiffness": {"modulus": (0.01, 0.1, 1, 10, 100, 1000), "connection": (1, 10, 100, 1e3, 1e4, 1e5)},
    "mesh": {"radius": (0.2, 0.4, 0.7, 1, 1.4, 2), "elements": (1, 2, 4, 8, 16, 25)},
    "load": {"tension": (0, 0.5, 1, 2, 4), "modulus": (0.01, 0.1, 1, 10, 100, 1000)},
    "damping": {"damping": (0, 1, 10, 100, 1000), "connection": (1, 10, 100, 1e3, 1e4, 1e5)},
    "ground": {"ground": (1, 10, 100, 1e3, 1e4, 1e5), "dashpot": (0, 0.5, 1, 2)},
    "ball": {"ball": (0.1, 1, 10), "density": (0.1, 1, 10)},
    "contact": {"contact": (0.1, 1, 10), "tension": (2, 4)},
}
BALL_RADIUS, BALL_LEVEL = 0.016, 2.0
"""Of a ball [m] that just fits into a ring of three pairs of rods, which closes on it as its muscles pull."""


@dataclass(frozen=True)
class Case:
    """A design by its factors, and where it stands in the report."""

    group: str
    design: dict[str, Any]
    factors: dict[str, float] = field(default_factory=dict)
    world: dict[str, Any] = field(default_factory=dict)
    """What surrounds it, in dict form."""


def grid_cases(quick: bool) -> Iterator[Case]:
    """Every pair of values of each pair of parameters; every other value of each in the quick form."""
    for group, axes in GRID.items():
        (x, xs), (y, ys) = axes.items()
        for b in ys[:: 2 if quick else 1]:
            for a in xs[:: 2 if quick else 1]:
                factors = {x: a, y: b}
                base = "free" if group == "ground" else "clamped"
                world = WORLDS[group](a, b).to_dict() if group in WORLDS else {}
                yield Case(group, _scaled(factors, n_pairs=3, base=base), factors, world)


def lying(stiffness: float, damping_ratio: float) -> World:
    """Lie in water on a ground with factors on the default's stiffness and its ratio of damping to critical."""
    default = Ground()
    damping = damping_ratio * math.sqrt(stiffness) * default.damping
    ground = replace(default, stiffness=stiffness * default.stiffness, damping=damping)
    return World(medium=Medium(), ground=ground, lying=True)


def swallowing(stiffness: float, density: float) -> World:
    """Have a ball inside, with factors on the default's stiffness and density and its ratio of damping to critical."""
    default = Ball()
    damping = math.sqrt(stiffness * density) * default.damping
    ball = replace(default, stiffness=stiffness * default.stiffness, density=density * default.density, damping=damping)
    return World(ball=replace(ball, radius=BALL_RADIUS, level=BALL_LEVEL))


def touching(stiffness: float, tension: float) -> World:
    """Let rods touch, with a factor on the default's stiffness and its ratio of damping to critical."""
    default = Contact()
    return World(
        contact=Contact(stiffness=stiffness * default.stiffness, damping=math.sqrt(stiffness) * default.damping)
    )


WORLDS: dict[str, Callable[[float, float], World]] = {"ground": lying, "ball": swallowing, "contact": touching}
"""What surrounds the worms of a group, given the factors on its two axes."""
BOUNDS = ("ball", "contact")
"""Groups whose prediction is for all that may touch, not for what does: it may well be far too small."""


def _scaled(factors: dict[str, float], **changes: Any) -> dict[str, Any]:
    """Fields of the default design with factors on them."""
    default = LatticeDesign()
    fields_of = {
        "modulus": ("structure_youngs_modulus", "muscle_youngs_modulus"),
        "connection": ("joint_stiffness",),
        "radius": ("structure_radius", "muscle_radius"),
        "tension": ("max_tension",),
        "damping": ("damping", "rotational_damping"),
    }
    values = {name: getattr(default, name) * f for key, f in factors.items() for name in fields_of.get(key, ())}
    if "elements" in factors:
        values["elements_per_segment"] = int(factors["elements"])
    return values | changes


def random_cases(number: int, seed: int = 0) -> Iterator[Case]:
    """Random designs over the whole range, structure and muscles apart; what has no room is drawn again."""
    rng = np.random.default_rng(seed)
    default = LatticeDesign()
    made = 0
    while made < number:
        n_pairs, period_ratio = PAIRS_AND_PERIODS[rng.integers(len(PAIRS_AND_PERIODS))]
        damping = 0.0 if rng.random() < 0.2 else _spread(rng, 0.1, 1e3)
        design: dict[str, Any] = {
            "n_pairs": n_pairs,
            "period_ratio": period_ratio,
            "base": ("clamped", "free")[rng.integers(2)],
            "muscle_model": ("rod", "rod", "line")[rng.integers(3)],
            "elements_per_segment": round(_spread(rng, 1.0, 25.0)),
            "structure_youngs_modulus": default.structure_youngs_modulus * _spread(rng, 1e-2, 1e3),
            "muscle_youngs_modulus": default.muscle_youngs_modulus * _spread(rng, 1e-2, 1e3),
            "structure_radius": default.structure_radius * _spread(rng, 0.2, 2.0),
            "muscle_radius": default.muscle_radius * _spread(rng, 0.2, 2.0),
            "joint_stiffness": default.joint_stiffness * _spread(rng, 1.0, 1e5),
            "joint_damping": 0.0 if rng.random() < 0.7 else _spread(rng, 1e-3, 1.0),
            "max_tension": default.max_tension * _spread(rng, 0.1, 4.0),
            "damping": default.damping * damping,
            "rotational_damping": default.rotational_damping * damping * float(rng.integers(2)),
        }
        try:
            LatticeDesign(**design)
        except ValueError:
            continue
        made += 1
        yield Case("random", design)


def _spread(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
