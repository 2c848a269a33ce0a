"""One assembly in time: an engine without the axis of worms."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lattice_gym.engines.arguments import tension_ramp
from lattice_gym.engines.base import Engine
from lattice_gym.engines.health import Health
from lattice_gym.engines.registry import EngineName, make_engine
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import Ledger
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.state import RodState


class Simulation:
    """An engine that holds one assembly.

    Raises
    ------
    ValueError
        The engine holds more than one.
    """

    def __init__(self, engine: Engine) -> None:
        if engine.n_worm != 1:
            raise ValueError(f"engine: must hold one assembly, holds {engine.n_worm}")
        self.engine = engine

    @property
    def model(self) -> RodModel:
        """What is simulated."""
        return self.engine.models[0]

    @property
    def dt(self) -> float:
        """Time step [s]."""
        return self.engine.dt

    @property
    def state(self) -> RodState:
        """A copy of the state."""
        return self.engine.state()

    @property
    def ledger(self) -> Ledger | None:
        """Energy over the last call to `advance`, see `Engine.ledger`."""
        return self.engine.ledger()

    @property
    def step_error(self) -> float | None:
        """Distance from a run at half the step, see `Engine.step_error`."""
        return self.engine.step_error()

    def advance(self, tension: npt.ArrayLike, n_substeps: int) -> Health:
        """Advance by n_substeps * dt.

        Parameters
        ----------
        tension
            Muscle tensions [N], shape (n_muscle,) and held, or (2, n_muscle): a ramp, as in `Engine.advance`.
        n_substeps
            Number of steps, at least 1.

        Raises
        ------
        ValueError
            Wrong shape, a tension that is negative or not finite, or no step.
        """
        ramp = tension_ramp(tension, (self.model.n_muscle,))
        self.engine.advance(np.stack(ramp)[:, None], n_substeps)
        return self.engine.health()

    def restore(self, state: RodState) -> None:
        """Take over a state, see `Engine.restore`."""
        self.engine.restore(0, state)


def simulate(
    name: EngineName,
    model: RodModel,
    dt: float,
    splitting: Splitting = "pyelastica",
    energy_check: bool = False,
    step_check: bool = False,
) -> Simulation:
    """Simulate one assembly with an engine by its name.

    Raises
    ------
    ValueError
        An unknown name, or an argument that the engine refuses, see `Engine`.
    """
    engine = make_engine(name, [model], dt, splitting, energy_check=energy_check, step_check=step_check, num_threads=1)
    return Simulation(engine)
