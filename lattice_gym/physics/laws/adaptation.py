"""How the strength of a muscle changes with use: growth, and as its opposite fatigue and recovery."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from lattice_gym.checks import FloatArray, Parameters, array, checked, choice, flag, number, real

MODES = ("continuous", "episode")


@dataclass(frozen=True, eq=False)
class Strength:
    """Strength of every muscle over that of a fresh, untrained one, and its use so far: shape (..., n_muscle)."""

    growth: FloatArray
    """Factor by growth, from 1 to the cap."""
    fresh: FloatArray
    """Share that is not fatigued, from 0 to 1."""
    strain_integral: FloatArray
    """Integral of |strain| over the episode [s]; only with the mode "episode"."""
    tension_integral: FloatArray
    """Integral of the tension over the episode [N s]; only with the mode "episode"."""
    time: FloatArray | float = 0.0
    """Time of both integrals [s], shape (...,)."""

    def __repr__(self) -> str:
        return f"Strength({self.growth.shape[-1]} muscles, factor {self.factor.min():.6g} to {self.factor.max():.6g})"

    @property
    def factor(self) -> FloatArray:
        """Factor on the tension."""
        return self.growth * self.fresh

    def row(self, worm: int) -> Strength:
        """Strength of one of several worms."""
        parts = (self.growth, self.fresh, self.strain_integral, self.tension_integral)
        time = np.broadcast_to(self.time, self.growth.shape[:1])
        return Strength(*(part[worm] for part in (*parts, time)))

    def where(self, changed: npt.NDArray[np.bool_], other: Strength) -> Strength:
        """Strength of worms of which some, shape (n_worm,), have changed to another."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Strength(*(np.where(changed if np.ndim(old) < 2 else changed[:, None], new, old) for old, new in pairs))


@dataclass(frozen=True, kw_only=True)
class Adaptation(Parameters):
    """How use changes the strength of muscles; by default it does not.

    Growth: once an episode a strength is multiplied by

        alpha = 1 + strain_gain |strain| + force_gain tension

    and capped, with the means of strain and tension over the episode. That is the law that notes of a third party
    ascribe to Schaffer, Pamu and Webster-Wood (2024, arXiv 2408.16069), with gains of 1e-6 and 4e-8 in units they do
    not give and a cap of 2; the paper itself could not be checked. The mode "continuous" multiplies by
    alpha^(t / episode) after every control step t instead, with that step's strain and tension: under constant use over
    one nominal episode both come to the same.

    Fatigue: of the motor units, all those that are not fatigued work as far as they are activated (a), and

        d fresh / dt = -fatigue_rate a fresh + recovery_rate (1 - fresh)

    This is the flow between active and fatigued units of Liu, Brown and Yue (2002, Biophys. J. 82:2344) and of Xia and
    Frey Law (2008, J. Biomech. 41:3046), where recruitment takes no time. Constant use leads towards
    recovery_rate / (fatigue_rate a + recovery_rate); rest restores with the time constant 1 / recovery_rate. Over a
    control step it is solved exactly for its mean activation.

    The strength is the product of both, held within a control step. Raises ValueError for a field out of bounds.
    """

    strain_gain: float = real(0.0, 0.0, 1e6, "1")
    """Growth by strain [1]."""
    force_gain: float = real(0.0, 0.0, 1e6, "1/N")
    """Growth by tension [1/N]."""
    cap: float = real(2.0, 1.0, 1e3, "1")
    """Largest factor by growth."""
    mode: str = checked("continuous", choice, choices=MODES)
    """When muscles grow: "continuous", or "episode", at the reset that follows it (which needs `carry`)."""
    episode: float = real(10.0, 1e-3, 1e9, "s")
    """Nominal length of an episode [s], in the mode "continuous"."""
    fatigue_rate: float = real(0.0, 0.0, 1e3, "1/s")
    """[1/s]"""
    recovery_rate: float = real(0.0, 0.0, 1e3, "1/s")
    """[1/s]"""
    carry: bool = checked(False, flag)
    """Keep strengths over a reset; otherwise every episode begins with fresh, untrained muscles."""
    observed: bool = checked(False, flag)
    """Observe the strength of every muscle."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mode == "episode" and not self.carry:
            raise self._refused("carry", 'the mode "episode" changes strengths at the reset, and needs it')

    @property
    def max_strength(self) -> float:
        """Largest strength there can be."""
        return self.cap if self.strain_gain > 0.0 or self.force_gain > 0.0 else 1.0

    def initial(self, shape: int | tuple[int, ...]) -> Strength:
        """Strength of fresh, untrained muscles: their number, or (..., n_muscle)."""
        growth = np.ones(shape)
        return Strength(growth, growth.copy(), 0.0 * growth, 0.0 * growth, np.zeros(growth.shape[:-1]))

    def advance(
        self,
        strength: Strength,
        activation: npt.ArrayLike,
        tension: npt.ArrayLike,
        strain: npt.ArrayLike,
        duration: float,
    ) -> Strength:
        """Strength after constant use over some time.

        Parameters
        ----------
        strength
            Strength before.
        activation, tension, strain
            Of every muscle, shape as the strength's: in [0, 1], not negative [N], and length over rest length less 1.
        duration
            [s]

        Raises
        ------
        ValueError
            A use of another shape, or out of bounds.
        """
        shape = strength.growth.shape
        active = array("activation", activation, shape, 0.0, 1.0)
        load = array("tension", tension, shape, 0.0, unit="N")
        strained = np.abs(array("strain", strain, shape))
        time = number("duration", duration, 0.0, unit="s")
        rate = self.fatigue_rate * active + self.recovery_rate
        goal = np.where(rate > 0.0, self.recovery_rate / np.where(rate > 0.0, rate, 1.0), strength.fresh)
        fresh = goal + (strength.fresh - goal) * np.exp(-rate * time)
        if self.mode == "episode":
            sums = strength.strain_integral + time * strained, strength.tension_integral + time * load
            return Strength(strength.growth, fresh, *sums, strength.time + time)
        return replace(strength, growth=self._grow(strength.growth, strained, load, time / self.episode), fresh=fresh)

    def at_reset(self, strength: Strength) -> Strength:
        """Strength with which the next episode begins, of one worm."""
        n_muscle = len(strength.growth)
        if not self.carry:
            return self.initial(n_muscle)
        if strength.time == 0.0:
            return strength
        growth = self._grow(
            strength.growth, strength.strain_integral / strength.time, strength.tension_integral / strength.time, 1.0
        )
        return replace(self.initial(n_muscle), growth=growth, fresh=strength.fresh)

    def _grow(self, growth: FloatArray, strain: FloatArray, tension: FloatArray, episodes: float) -> FloatArray:
        with np.errstate(over="ignore"):  # What overflows is capped.
            alpha = 1.0 + self.strain_gain * strain + self.force_gain * tension
            return np.minimum(growth * alpha**episodes, self.cap)
