"""The fused engine: for now a loop over assemblies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.base import Engine
from lattice_gym.engines.fused import kernels
from lattice_gym.engines.fused.pack import Pack, _aligned, node_decay
from lattice_gym.engines.health import Health, Status
from lattice_gym.physics.assembly import RodModel
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws import contact
from lattice_gym.physics.laws.damping import Splitting, damping_shares
from lattice_gym.physics.rod import MAX_DILATATION
from lattice_gym.physics.state import RodState

_LARGEST_RATE = 300.0
_SKIN = 0.25
"""How much further than they touch elements are listed, over the largest radii of two of them together."""
_LISTED = 16
"""Pairs for which there is room between calls, per element; where more are listed every call lists anew."""


class FusedAssembly:
    """All rods of equal element count side by side in lanes; see `kernels`."""

    def __init__(self, model: RodModel, dt: float, splitting: Splitting, energy_check: bool) -> None:
        self.model, self.dt = model, dt
        self._splitting = splitting
        self._pack = Pack([model], self.dt, splitting)
        self._cells = self._pack.cells
        self._node = self._pack.node[0][0], self._pack.node[1][0]
        self._element = self._pack.element[0][0], self._pack.element[1][0]
        self._ball = self._pack_ball()
        self._contact = self._pack_contact()
        self._account = self._open_account() if energy_check else None
        if energy_check:
            self._pack.work = _aligned(kernels.WORK, 2 ** self._pack.place.n_cell.bit_length())

    def _open_account(self) -> kernels.Account:
        """Account with nothing in it: constants of every node and element by record and lane."""
        n_cell, lanes = self._pack.place.n_cell, kernels.LANES
        after, before, mixed, inertia, length, pull = np.zeros((6, n_cell, lanes))
        velocity, omega, held = np.zeros((3, n_cell, 3, lanes))
        line, line_pull = np.zeros((2, len(self.model.lines)))
        node, element = self._node, self._element
        rate = node_decay(self.model, self.dt)
        if self._splitting != "symmetric":
            # A rate this large leaves no speed worth counting; without the bound what it left would overflow.
            rate = np.minimum(rate, _LARGEST_RATE)
        early, late = damping_shares(rate, self._splitting)
        half = 0.5 * self.model.node_mass
        after[node], before[node], mixed[node] = (
            half * (1.0 / late - 1.0),
            half * (1.0 - early),
            half * (1.0 / late - early),
        )
        inertia[element] = np.concatenate([rod.inertia for rod in self.model.rods])
        moved = length, pull, velocity, omega, held, line, line_pull
        return kernels.Account(np.zeros(3), after, before, mixed, inertia, *moved)

    def _pack_ball(self) -> kernels.Ball | None:
        ball = self.model.bolus
        if ball is None:
            return None
        reach = np.zeros((self._pack.place.n_cell, kernels.LANES))
        reach[self._element] = ball.radius + self.model.element_radius
        return kernels.Ball(
            place=ball.position.copy(), speed=np.zeros(3), spin=np.zeros(3), force=np.array(ball.force),
            load=np.zeros(3), reach=reach, close=np.zeros(self._pack.place.n_cell, np.bool_), cell=self._element[0],
            lane=self._element[1], touches=np.zeros(self.model.n_elem, kernels.TOUCH),
            nodes=np.zeros((2 * self.model.n_elem, 3)),
            kick=self.dt / ball.mass, spin_kick=self.dt / ball.inertia,
            stiffness=ball.stiffness, damping=ball.damping, friction=ball.friction,
        )  # fmt: skip

    def _pack_contact(self) -> kernels.Contact | None:
        law, model = self.model.contact, self.model
        if law is None:
            return None
        element = contact.touchable(model)
        n_elem = len(element)
        rod, radius = contact.rod_of(model)[element], model.element_radius[element]
        never = np.searchsorted(element, contact.excluded(model))
        rest = np.concatenate([part.rest_length for part in model.rods])
        return kernels.Contact(
            cell=self._element[0][element], lane=self._element[1][element], rod=rod, radius=radius,
            never=never[:, 1].copy(), row=np.searchsorted(never[:, 0], np.arange(n_elem + 1)),
            listed=np.full((n_elem, 2, 3), np.inf), ends=np.zeros((n_elem, 2, 3)),
            pairs=np.zeros((_LISTED * n_elem + 1, 2), np.int64), used=np.zeros(1, np.int64),
            grid=np.zeros((n_elem, 3), np.int64),
            head=np.zeros(2 ** (2 * n_elem).bit_length(), np.int64), behind=np.zeros(n_elem, np.int64),
            stiffness=law.stiffness, damping=law.damping, skin=_SKIN * 2.0 * float(radius.max(initial=0.0)),
            longest=MAX_DILATATION * float(rest[element].max(initial=0.0)),
        )  # fmt: skip

    @property
    def state(self) -> RodState:
        """A copy of the state."""
        state, ball = self._pack.state(0), self._ball
        if ball is None:
            return state
        place, speed, spin = np.stack([ball.place, ball.speed, ball.spin])[:, None]
        return replace(state, bolus_position=place, bolus_velocity=speed, bolus_omega=spin)

    def restore(self, state: RodState) -> None:
        """Take over a state."""
        self._pack.restore(0, state)
        if self._ball is not None:
            self._ball.place[:], self._ball.speed[:] = state.bolus_position[0], state.bolus_velocity[0]
            self._ball.spin[:] = state.bolus_omega[0]
        if self._contact is not None:
            # Where a run diverged before, nothing could tell how far nodes have gone since.
            self._contact.listed[:] = np.inf

    def advance(self, start: FloatArray, end: FloatArray, n_substeps: int) -> Health:
        """Advance with tensions from `start` to `end` [N], shape (n_muscle,)."""
        if self._account is not None:
            self._account.total[:] = 0.0
        self._pack.advance(start[None], end[None], n_substeps, self._ball, self._contact, self._account)
        health, ball = self._pack.health(0), self._ball
        if not health.ok or ball is None:
            return health
        sound = np.isfinite([ball.place, ball.speed, ball.spin]).all()
        return health if sound else Health(Status.NON_FINITE)

    def flow(self) -> Flow:
        """Return what the account holds."""
        assert self._account is not None
        return Flow(*self._account.total.tolist())


class FusedEngine(Engine):
    """Assemblies one after another; the laned engine takes its place."""

    def __init__(
        self,
        models: Sequence[RodModel],
        dt: float,
        splitting: Splitting = "pyelastica",
        *,
        energy_check: bool = False,
        step_check: bool = False,
        num_threads: int | None = None,
    ) -> None:
        super().__init__(
            models, dt, splitting, energy_check=energy_check, step_check=step_check, num_threads=num_threads
        )
        self._worms = [FusedAssembly(model, self.dt, splitting, energy_check) for model in self.models]
        self._ends = [Health()] * self.n_worm

    def _advance(self, start: FloatArray, end: FloatArray, n_substeps: int) -> IntArray:
        for worm, one in enumerate(self._worms):
            self._ends[worm] = one.advance(start[worm], end[worm], n_substeps)
            if self._ends[worm].ok:
                self._show(worm, one.state)
        return np.array([health.status for health in self._ends], np.int64)

    def _health(self, worm: int) -> Health:
        return self._ends[worm]

    def _state(self, worm: int) -> RodState:
        return self._worms[worm].state

    def _restore(self, worm: int, state: RodState) -> None:
        self._worms[worm].restore(state)

    def _replace(self, worm: int, model: RodModel) -> None:
        self._worms[worm] = FusedAssembly(model, self.dt, self.splitting, self.energy_check)

    def _flow(self, worm: int) -> Flow:
        return self._worms[worm].flow()
