"""The reference engine: the model assembled from PyElastica's own rods, joints, constraints, damping and stepper.

It calls none of the compiled laws of the fused engine; rest strains and curvatures are PyElastica's own, too. The
ground is ours: PyElastica's `RodPlaneContact` cancels what forces were summed on a node before it came, so that a rod
rests at the depth of its weight over the stiffness or at none at all, as gravity is declared after it or before.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from elastica.boundary_conditions import FixedConstraint
from elastica.dissipation import AnalyticalLinearDamper, DamperBase
from elastica.external_forces import GravityForces, NoForces
from elastica.joint import ConnectionBase, FreeJoint
from elastica.modules.base_system import BaseSystemCollection
from elastica.modules.connections import Connections
from elastica.modules.constraints import Constraints
from elastica.modules.damping import Damping
from elastica.modules.forcing import Forcing
from elastica.rigidbody.sphere import Sphere
from elastica.rod.cosserat_rod import CosseratRod
from elastica.timestepper.symplectic_steppers import PositionVerlet
from elastica.typing import ConnectionIndex, RigidBodyType, RodType

from lattice_gym.checks import FloatArray, IntArray
from lattice_gym.engines.base import Engine
from lattice_gym.engines.health import Health, Status, joint_gap_limits, overstretched, torn
from lattice_gym.physics.assembly import Ball, RodModel
from lattice_gym.physics.energy import Flow
from lattice_gym.physics.laws import contact
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.rod import MAX_DILATATION, MIN_DILATATION, Rod
from lattice_gym.physics.state import RodState
from lattice_gym.physics.world import Contact, Ground

_START = np.float64(0.0)
_LARGEST_RATE = 300.0
"""Damping this large leaves no speed worth counting; without the bound what it left would overflow."""

_SWEEPS, _EVEN = 6, 1e-9
"""Sweeps forth and back over the friction of the ball, at most; they end when none changed by more than this share of
the largest that may be."""


class _Assembly(BaseSystemCollection, Constraints, Connections, Forcing, Damping):
    """Rods with everything a model may hold."""


def _hill_share(hill: Hill, length: FloatArray, rate: FloatArray) -> FloatArray:
    """Share of the tension that acts, see `hill.Hill`; length over rest length and its rate [1/s], one shape, kept."""
    share: FloatArray = np.ones_like(length)
    if hill.width is not None:
        share *= np.exp(-(((length / hill.optimal_length - 1.0) / hill.width) ** 2))
    if hill.max_speed is not None:
        v, a, most = rate / hill.max_speed, hill.curvature, hill.eccentric
        c = (2.0 + 2.0 / a) / (most - 1.0)
        shortening, lengthening = np.minimum(v, 0.0), np.maximum(v, 0.0)
        hyperbola = np.where(v <= -1.0, 0.0, (1.0 + shortening) / (1.0 - shortening / a))
        share *= np.where(v <= 0.0, hyperbola, (1.0 + c * most * lengthening) / (1.0 + c * lengthening))
    return share


class _Contraction(NoForces[CosseratRod]):
    """Tension along every element of a muscle: pulls its two nodes together.

    `tension` [N] has shape (1,) and belongs to the engine, which writes it before each step; `acting` [N], shape
    (n_elem,), is what acted in that step.
    """

    def __init__(self, tension: FloatArray, acting: FloatArray, hill: Hill | None) -> None:
        super().__init__()
        self.tension = tension
        self.acting = acting
        self.hill = hill

    def apply_forces(self, system: CosseratRod, time: np.float64 = _START) -> None:
        self.acting[:] = self.tension
        if self.hill is not None:
            rate = np.sum(np.diff(system.velocity_collection) * system.tangents, axis=0) / system.rest_lengths
            self.acting *= _hill_share(self.hill, system.lengths / system.rest_lengths, rate)
        pull = self.acting * system.tangents
        system.external_forces[:, :-1] += pull
        system.external_forces[:, 1:] -= pull


class _LineMuscle(ConnectionBase[CosseratRod]):
    """Tension and stretch of a massless muscle between two nodes; `tension` and `acting` as in `_Contraction`."""

    def __init__(
        self, rest_length: float, stiffness: float, tension: FloatArray, acting: FloatArray, hill: Hill | None
    ) -> None:
        self.rest_length = rest_length
        self.stiffness = stiffness
        self.tension = tension
        self.acting = acting
        self.hill = hill

    def apply_forces(
        self,
        system_one: RodType | RigidBodyType,
        index_one: ConnectionIndex,
        system_two: RodType | RigidBodyType,
        index_two: ConnectionIndex,
        time: np.float64 = _START,
    ) -> None:
        side = system_two.position_collection[:, index_two] - system_one.position_collection[:, index_one]
        length = np.linalg.norm(side)
        dilatation = length / self.rest_length
        self.acting[:] = self.tension
        if self.hill is not None:
            apart = system_two.velocity_collection[:, index_two] - system_one.velocity_collection[:, index_one]
            rate = apart @ side / length / self.rest_length
            self.acting *= _hill_share(self.hill, np.atleast_1d(dilatation), np.atleast_1d(rate))
        force = (self.acting[0] + self.stiffness * (dilatation - 1.0) / dilatation) * side / length
        system_one.external_forces[:, index_one] += force
        system_two.external_forces[:, index_two] -= force

    def apply_torques(
        self,
        system_one: RodType | RigidBodyType,
        index_one: ConnectionIndex,
        system_two: RodType | RigidBodyType,
        index_two: ConnectionIndex,
        time: np.float64 = _START,
    ) -> None:
        """Turn nothing: the force goes through the nodes."""


class _NodeDamper(AnalyticalLinearDamper):
    """PyElastica's damper with a constant for each node [N s/m], shape (n_node,), where lines add to the rod's own."""

    def __init__(self, node_damping: FloatArray, rotational_damping: float, time_step: float, **kwargs: Any) -> None:
        super().__init__(
            translational_damping_constant=0.0,
            rotational_damping_constant=rotational_damping,
            time_step=np.float64(time_step),
            **kwargs,
        )
        self._translational_damping_coefficient = np.exp(-node_damping / self.system.mass * time_step)


class _PointLoads(NoForces[CosseratRod]):
    """Constant forces on nodes (laboratory frame) and torques on elements (material frame) of one rod."""

    def __init__(self, forces: FloatArray, torques: FloatArray) -> None:
        super().__init__()
        self.forces = forces
        self.torques = torques

    def apply_forces(self, system: CosseratRod, time: np.float64 = _START) -> None:
        system.external_forces += self.forces

    def apply_torques(self, system: CosseratRod, time: np.float64 = _START) -> None:
        system.external_torques += self.torques


class _Hold:
    """Where the ball touches elements in a step, n of them: written by its contact, read by its friction.

    `first` holds the row of each element's first node, `share` what its nodes bear by the lever rule, shape (2, n);
    `gap` [m] leads from the centre line to the ball's centre, along `normal`, and `early` is the slip before the kick
    [m/s], shape (n, 3); `most` is the largest friction [N], shape (n,).
    """

    def __init__(self) -> None:
        self.first = np.zeros(0, np.int64)
        self.share, self.gap, self.normal, self.early = np.zeros((2, 0)), *np.zeros((3, 0, 3))
        self.most = np.zeros(0)

    def slip(self, ball: Sphere, rods: list[CosseratRod]) -> tuple[FloatArray, FloatArray]:
        """Velocity of the ball over each element [m/s], along the surface, shape (n, 3), and off it, shape (n,)."""
        spin = ball.director_collection[..., 0].T @ ball.omega_collection[:, 0]
        speed = np.concatenate([rod.velocity_collection.T for rod in rods])
        near, far = self.share[..., None]
        apart = ball.velocity_collection[:, 0] - np.cross(spin, self.gap)
        apart = apart - near * speed[self.first] - far * speed[self.first + 1]
        rate = np.sum(apart * self.normal, axis=1)
        return apart - rate[:, None] * self.normal, rate


class _BallContact(NoForces[Sphere]):
    """Constant force on the ball, and the normal force of its contact with every rod, as `model.Ball` has it.

    PyElastica's RodSphereContact takes the middles of elements for their starts, half an element off, and its friction
    turns no ball. All rods are here at once, as the friction of each touch depends on that of others. `hold` is what
    is touched, `lost` gathers the power dissipated [W], shape (1,).
    """

    def __init__(self, model: RodModel, ball: Ball, rods: list[CosseratRod], hold: _Hold, lost: FloatArray) -> None:
        super().__init__()
        self.ball, self.rods, self.hold, self.lost = ball, rods, hold, lost
        self.reach = ball.radius + np.concatenate([rod.radius for rod in model.rods])
        self.rows = [model.nodes(index) for index in range(model.n_rod)]
        self.first = np.delete(np.arange(model.n_node), model.node_offset[1:] - 1)

    def apply_forces(self, system: Sphere, time: np.float64 = _START) -> None:
        ball, hold = self.ball, self.hold
        system.external_forces[:, 0] += ball.force
        place = np.concatenate([rod.position_collection.T for rod in self.rods])
        start, side = place[self.first], place[self.first + 1] - place[self.first]
        gap = system.position_collection[:, 0] - start
        far = np.clip(np.sum(gap * side, axis=1) / np.sum(side * side, axis=1), 0.0, 1.0)
        gap = gap - far[:, None] * side
        distance = np.linalg.norm(gap, axis=1)
        hit = np.flatnonzero(distance < self.reach)
        hold.first, hold.share, hold.gap = self.first[hit], np.stack([1.0 - far[hit], far[hit]]), gap[hit]
        hold.normal = gap[hit] / np.where(distance > 0.0, distance, 1.0)[hit, None]
        hold.early, rate = hold.slip(system, self.rods)
        spring = ball.stiffness * (self.reach - distance)[hit]
        push = np.maximum(spring - ball.damping * rate, 0.0)
        hold.most = ball.friction * push
        system.external_forces[:, 0] += push @ hold.normal
        on_node = np.zeros_like(place)
        for node, share in zip((hold.first, hold.first + 1), hold.share, strict=True):
            np.subtract.at(on_node, node, (share * push)[:, None] * hold.normal)
        for rod, rows in zip(self.rods, self.rows, strict=True):
            rod.external_forces += on_node[rows].T
        self.lost += float(np.sum((spring - push) * rate))


class _BallFriction(DamperBase[Sphere]):
    """Coulomb friction of the ball: impulses against the slip that all else left, bounded by the normal ones.

    Which friction takes all slip follows from what a unit of each changes any slip by, an array of shape (3 n, 3 n),
    by the projected method of Gauss and Seidel, in the order of the elements and back. It comes last of all, see
    `_GroundFriction`. A unit of force adds `node_push`, shape (n_node,), to the velocity of a node in a step; `push`
    are the two numbers of the ball, for force and torque.
    """

    def __init__(
        self,
        rods: list[CosseratRod],
        hold: _Hold,
        node_push: FloatArray,
        push: tuple[float, float],
        lost: FloatArray,
        **kwargs: Any,
    ) -> None:
        super().__init__(**kwargs)
        self.rods, self.hold, self.node_push, self.push, self.lost = rods, hold, node_push, push, lost
        self.rows = np.cumsum([0] + [len(rod.mass) for rod in rods])

    def dampen_rates(self, system: Sphere, time: np.float64 = _START) -> None:
        hold, rubs = self.hold, np.flatnonzero(self.hold.most > 0.0)
        if rubs.size == 0:
            return
        drag = np.zeros_like(hold.gap)
        slip, _ = hold.slip(system, self.rods)
        drag[rubs] = self._balance(slip[rubs], rubs)
        moment = np.cross(hold.gap, drag).sum(axis=0)
        system.velocity_collection[:, 0] += self.push[0] * drag.sum(axis=0)
        system.omega_collection[:, 0] -= system.director_collection[..., 0] @ (self.push[1] * moment)
        on_node = np.zeros((self.rows[-1], 3))
        for node, share in zip((hold.first, hold.first + 1), hold.share, strict=True):
            np.add.at(on_node, node, share[:, None] * drag)
        moved = self.node_push[:, None] * on_node
        for rod, first, last in zip(self.rods, self.rows[:-1], self.rows[1:], strict=True):
            rod.velocity_collection -= moved[first:last].T
        slip, _ = hold.slip(system, self.rods)
        self.lost -= 0.5 * float(np.sum(drag * (hold.early + slip)))

    def _balance(self, slip: FloatArray, rubs: IntArray) -> FloatArray:
        """Friction [N] of the touches `rubs`, given the slip there without any [m/s], both of shape (n, 3)."""
        own, response = self._response(rubs)
        most, drag = self.hold.most[rubs], np.zeros_like(slip)
        forth = range(len(rubs))
        for _ in range(_SWEEPS):
            change = 0.0
            for order in (forth, reversed(forth)):
                before = drag.copy()
                for k in order:
                    new = drag[k] - (slip[k] + response[k] @ drag.ravel()) / own[k]
                    size = math.sqrt(new @ new)
                    drag[k] = new if size <= most[k] else most[k] / size * new
                change = max(change, float(np.linalg.norm(drag - before, axis=1).max()))
            if not change > _EVEN * most.max():
                break
        return drag

    def _response(self, rubs: IntArray) -> tuple[FloatArray, FloatArray]:
        """Change of the slip of each touch in a step, per unit of its own friction and of that of any [m/(N s)].

        Of the shapes (n,) and (n, 3, 3 n): the former is one number in all directions along the surface.
        """
        gap, normal, n_rub = self.hold.gap[rubs], self.hold.normal[rubs], len(rubs)
        node = self.hold.first[rubs] + np.array([[0], [1]])
        alike = self.push[0] + self.push[1] * (gap @ gap.T)
        for one, share in zip(node, self.hold.share[:, rubs], strict=True):
            given = self.node_push[one] * share
            for other, bears in zip(node, self.hold.share[:, rubs], strict=True):
                alike += np.where(one[:, None] == other, given[:, None] * bears, 0.0)
        response = alike[:, None, :, None] * np.eye(3)[:, None] - self.push[1] * np.einsum("bi,aj->aibj", gap, gap)
        response -= normal[:, :, None, None] * np.einsum("ai,aibj->abj", normal, response)[:, None]
        return np.diag(alike), response.reshape(n_rub, 3, 3 * n_rub)


class _SelfContact(NoForces[CosseratRod]):
    """Push of rods at each other, as `lattice_gym.contact` has it: every pair of elements is tried at every step.

    Declared once, for one rod, it acts on all. `lost` gathers the power dissipated [W], shape (1,).
    """

    def __init__(self, model: RodModel, law: Contact, rods: list[CosseratRod], lost: FloatArray) -> None:
        super().__init__()
        self.law, self.rods, self.lost = law, rods, lost
        self.rows = [model.nodes(index) for index in range(model.n_rod)]
        self.first = np.delete(np.arange(model.n_node), model.node_offset[1:] - 1)
        self.radius = np.concatenate([rod.radius for rod in model.rods])
        rod = np.repeat(np.arange(model.n_rod), [len(made.rest_lengths) for made in rods])
        solid = ~np.isin(rod, model.muscles)
        pairs: IntArray = np.argwhere(solid[:, None] & solid & (rod[:, None] < rod))
        number = [model.n_elem, 1]
        pairs = pairs[~np.isin(pairs @ number, contact.excluded(model) @ number)]
        self.pairs = pairs[:, 0], pairs[:, 1]

    def apply_forces(self, system: CosseratRod, time: np.float64 = _START) -> None:
        place = np.concatenate([rod.position_collection.T for rod in self.rods])
        start, side = place[self.first], place[self.first + 1] - place[self.first]
        i, j = self.pairs
        share = np.stack(contact.nearest(start[i], side[i], start[j], side[j]))[..., None]
        gap = start[i] + share[0] * side[i] - start[j] - share[1] * side[j]
        distance = np.linalg.norm(gap, axis=1)
        hit = np.flatnonzero(self.radius[i] + self.radius[j] > distance)
        if hit.size == 0:
            return
        i, j, share, distance = i[hit], j[hit], share[:, hit], distance[hit]
        normal = gap[hit] / np.where(distance > 0.0, distance, 1.0)[:, None]
        speed = np.concatenate([rod.velocity_collection.T for rod in self.rods])
        at = [
            (1.0 - s) * speed[self.first[e]] + s * speed[self.first[e] + 1] for s, e in zip(share, (i, j), strict=True)
        ]
        rate = np.sum((at[0] - at[1]) * normal, axis=1)
        spring = self.law.stiffness * (self.radius[i] + self.radius[j] - distance)
        push = np.maximum(spring - self.law.damping * rate, 0.0)
        force, on_node = push[:, None] * normal, np.zeros_like(place)
        for s, e, sign in zip(share, (i, j), (1.0, -1.0), strict=True):
            np.add.at(on_node, self.first[e], sign * (1.0 - s) * force)
            np.add.at(on_node, self.first[e] + 1, sign * s * force)
        for rod, rows in zip(self.rods, self.rows, strict=True):
            rod.external_forces += on_node[rows].T
        self.lost += float(np.sum((spring - push) * rate))


def _clear(body: CosseratRod | Sphere) -> None:
    """Set what a step leaves behind to zero: PyElastica does so by multiplication, which keeps what is not finite."""
    for left_over in (body.acceleration_collection, body.alpha_collection, body.external_forces, body.external_torques):
        left_over[:] = 0.0


@dataclass(frozen=True, eq=False)
class _Footing:
    """What the ground does to the nodes of one rod in a step: written by its two parts, one before and one after.

    `normal` is its normal force [N] and `dashpot` what that has from the dashpot, shape (n_node,); `friction` is in
    the plane [N], shape (2, n_node).
    """

    normal: FloatArray
    dashpot: FloatArray
    friction: FloatArray


class _GroundForce(NoForces[CosseratRod]):
    """Normal force of the plane z = 0 on the nodes of one rod, whose radii there are given [m], shape (n_node,)."""

    def __init__(self, ground: Ground, radius: FloatArray, footing: _Footing) -> None:
        super().__init__()
        self.ground, self.radius, self.footing = ground, radius, footing

    def apply_forces(self, system: CosseratRod, time: np.float64 = _START) -> None:
        depth = np.maximum(self.radius - system.position_collection[2], 0.0)
        spring = self.ground.stiffness * depth
        dashpot = np.where(depth > 0.0, -self.ground.damping * system.velocity_collection[2], 0.0)
        self.footing.normal[:] = np.maximum(spring + dashpot, 0.0)
        self.footing.dashpot[:] = self.footing.normal - spring
        system.external_forces[2] += self.footing.normal


class _BodyAxis(NoForces[CosseratRod]):
    """No force: writes the unit vector from the mean first to the mean last node of the given rods, shape (3,)."""

    def __init__(self, rods: list[CosseratRod], axis: FloatArray) -> None:
        super().__init__()
        self.rods, self.axis = rods, axis

    def apply_forces(self, system: CosseratRod, time: np.float64 = _START) -> None:
        chord = np.mean([rod.position_collection[:, -1] - rod.position_collection[:, 0] for rod in self.rods], axis=0)
        self.axis[:] = chord / np.linalg.norm(chord)


class _GroundFriction(DamperBase[CosseratRod]):
    """Coulomb friction: an impulse against the slip that all else left, at most its coefficient times the normal one.

    PyElastica damps in the order in which dampers are declared, after all kicks and constraints: this comes last.
    `push` is what a unit force adds to a node's velocity in a step, shape (n_node,); `axis` is the body's, shape (3,),
    None where friction is the same in all directions.
    """

    def __init__(
        self, ground: Ground, push: FloatArray, footing: _Footing, axis: FloatArray | None, **kwargs: Any
    ) -> None:
        super().__init__(**kwargs)
        self.ground, self.push, self.footing, self.axis = ground, push, footing, axis

    def dampen_rates(self, system: CosseratRod, time: np.float64 = _START) -> None:
        slip, ground = system.velocity_collection[:2], self.ground
        speed = np.hypot(slip[0], slip[1])
        direction = np.divide(slip, speed, out=np.zeros_like(slip), where=speed > 0.0)
        if self.axis is None:
            factor = ground.sideways * np.hypot(direction[0], direction[1])
        else:
            # The same vector on the body axis, on the horizontal across it, and what is left where the axis is tilted.
            e = self.axis
            forth, aside = e[0] * direction[0] + e[1] * direction[1], e[0] * direction[1] - e[1] * direction[0]
            across = np.hypot(aside, e[2] * np.hypot(direction[0], direction[1]))
            along = np.where(forth > 0.0, ground.forward, ground.backward)
            factor = np.hypot(along * forth, ground.sideways * across)
        bound = self.footing.normal * factor
        sticks = speed <= ground.static_friction * bound * self.push
        kinetic = -ground.kinetic_friction * bound * direction
        self.footing.friction[:] = np.where(sticks, -slip / self.push, kinetic)
        slip[:] = np.where(sticks, 0.0, slip + kinetic * self.push)


def _make_rod(rod: Rod) -> CosseratRod:
    """Rod in PyElastica's arrays (components first), free of stress in its shape or of its natural curvature."""
    made = CosseratRod.straight_rod(
        rod.n_elem,
        rod.position[0].copy(),
        rod.directors[0, 2].copy(),
        rod.directors[0, 0].copy(),
        float(rod.rest_length.sum()),
        cast(float, rod.radius.copy()),  # annotated as a number, taken as one per element
        rod.density,
        youngs_modulus=rod.youngs_modulus,
        shear_modulus=rod.shear_modulus,
        position=rod.position.T.copy(),
        directors=np.moveaxis(rod.directors, 0, -1).copy(),
    )
    made.rest_sigma[:] = made.sigma
    made.rest_kappa[:] = made.kappa if rod.natural_curvature is None else rod.natural_curvature.T
    return made


class Assembly:
    """One assembly in PyElastica 1.0.0."""

    def __init__(self, model: RodModel, dt: float, energy_check: bool = False) -> None:
        self.model, self.dt, self._energy_check = model, dt, energy_check
        self._rods = [_make_rod(rod) for rod in model.rods]
        for index, rod in enumerate(self._rods):
            rod.mass[:] = model.node_mass[model.nodes(index)]
        self._tension = np.zeros((model.n_muscle, 1))
        self._contact_loss = np.zeros(1)
        self._ball: Sphere | None = None
        self._hold = _Hold()
        self._footing: list[_Footing] = []
        self._n_pulled = sum(model.rods[index].n_elem for index in model.muscles)
        self._acting = np.zeros(self._n_pulled + len(model.lines))
        self._stepper = PositionVerlet()
        self._simulator = self._assemble()
        self._reach = joint_gap_limits(model)
        self._gone = np.zeros(3)
        self._time = 0.0

    def _assemble(self) -> _Assembly:
        model, rods, simulator = self.model, self._rods, _Assembly()
        simulator.extend(rods)
        for joint in model.joints:
            simulator.connect(rods[joint.rod_a], rods[joint.rod_b], joint.node_a, joint.node_b).using(
                FreeJoint, k=joint.stiffness, nu=joint.damping
            )
        counts = [model.rods[index].n_elem for index in model.muscles] + [1] * len(model.lines)
        acting = [self._acting[end - count : end] for count, end in zip(counts, np.cumsum(counts), strict=True)]
        for index, tension, acts in zip(model.muscles, self._tension, acting, strict=False):
            simulator.add_forcing_to(rods[index]).using(_Contraction, tension, acts, model.hill)
        n_rod = len(model.muscles)
        for line, tension, acts in zip(model.lines, self._tension[n_rod:], acting[n_rod:], strict=True):
            simulator.connect(rods[line.rod_a], rods[line.rod_b], line.node_a, line.node_b).using(
                _LineMuscle, line.rest_length, line.stiffness, tension, acts, model.hill
            )
        for index, (forces, torques) in self._point_loads().items():
            simulator.add_forcing_to(rods[index]).using(_PointLoads, forces, torques)
        if model.gravity is not None:
            for made in rods:
                simulator.add_forcing_to(made).using(GravityForces, acc_gravity=model.gravity)
        if model.bolus is not None:
            self._add_ball(simulator, model.bolus)
        if model.contact is not None:
            simulator.add_forcing_to(rods[0]).using(_SelfContact, model, model.contact, rods, self._contact_loss)
        nodes, elements = defaultdict(list), defaultdict(list)
        for clamp in model.clamps:
            if clamp.node is not None:
                nodes[clamp.rod].append(clamp.node)
            if clamp.element is not None:
                elements[clamp.rod].append(clamp.element)
        for index in sorted(nodes.keys() | elements.keys()):
            simulator.constrain(rods[index]).using(
                FixedConstraint,
                constrained_position_idx=tuple(nodes[index]),
                constrained_director_idx=tuple(elements[index]),
            )
        for index, (rod, made) in enumerate(zip(model.rods, rods, strict=True)):
            node_damping = model.node_damping[model.nodes(index)]
            if node_damping.any() or rod.rotational_damping > 0.0:
                simulator.dampen(made).using(_NodeDamper, node_damping, rod.rotational_damping, time_step=self.dt)
        if model.ground is not None:
            self._lay_ground(simulator, model.ground)
        if model.bolus is not None and model.bolus.friction > 0.0:
            self._rub_ball(simulator, model.bolus)
        simulator.finalize()
        return simulator

    def _add_ball(self, simulator: _Assembly, ball: Ball) -> None:
        """Add the ball, its force, and its contact with every rod."""
        self._ball = Sphere(ball.position.copy(), ball.radius, ball.mass / (4.0 / 3.0 * np.pi * ball.radius**3))
        simulator.append(self._ball)
        simulator.add_forcing_to(self._ball).using(
            _BallContact, self.model, ball, self._rods, self._hold, self._contact_loss
        )

    def _rub_ball(self, simulator: _Assembly, ball: Ball) -> None:
        """Add the friction of the ball; clamped nodes give way to none."""
        model = self.model
        push = self.dt / model.node_mass * np.exp(-model.node_damping / model.node_mass * self.dt)
        for clamp in model.clamps:
            if clamp.node is not None:
                push[model.nodes(clamp.rod)][clamp.node] = 0.0
        ball_push = self.dt / ball.mass, self.dt / ball.inertia
        damped = simulator.dampen(cast(CosseratRod, self._ball))  # takes any system, annotated as rods
        damped.using(_BallFriction, self._rods, self._hold, push, ball_push, self._contact_loss)

    def _lay_ground(self, simulator: _Assembly, ground: Ground) -> None:
        axis = None if ground.isotropic else np.zeros(3)
        if axis is not None:
            solid = [rod for index, rod in enumerate(self._rods) if index not in self.model.muscles]
            simulator.add_forcing_to(self._rods[0]).using(_BodyAxis, solid, axis)
        for index, rod in enumerate(self._rods):
            nodes, n_node = self.model.nodes(index), len(rod.mass)
            footing = _Footing(np.zeros(n_node), np.zeros(n_node), np.zeros((2, n_node)))
            kept = np.exp(-self.model.node_damping[nodes] / rod.mass * self.dt)
            simulator.add_forcing_to(rod).using(_GroundForce, ground, self.model.node_radius[nodes], footing)
            simulator.dampen(rod).using(_GroundFriction, ground, self.dt / rod.mass * kept, footing, axis)
            self._footing.append(footing)

    def _point_loads(self) -> dict[int, tuple[FloatArray, FloatArray]]:
        """Collect forces on nodes and torques on elements by rod; buoyancy is such a force."""
        loads: dict[int, tuple[FloatArray, FloatArray]] = {}
        model = self.model
        floats = model.gravity is not None and model.medium_density > 0.0
        loaded = {load.rod for load in model.forces} | {load.rod for load in model.torques}
        for index in range(model.n_rod) if floats else loaded:
            n_elem = model.rods[index].n_elem
            loads[index] = np.zeros((3, n_elem + 1)), np.zeros((3, n_elem))
            if model.gravity is not None:
                loads[index][0][:] -= np.outer(
                    model.gravity, model.medium_density * model.node_volume[model.nodes(index)]
                )
        for force in self.model.forces:
            loads[force.rod][0][:, force.node] += force.force
        for torque in self.model.torques:
            loads[torque.rod][1][:, torque.element] += torque.torque
        return loads

    @property
    def state(self) -> RodState:
        """A copy of the state."""
        return RodState(
            position=np.concatenate([rod.position_collection.T for rod in self._rods]),
            velocity=np.concatenate([rod.velocity_collection.T for rod in self._rods]),
            directors=np.concatenate([np.moveaxis(rod.director_collection, -1, 0) for rod in self._rods]),
            omega=np.concatenate([rod.omega_collection.T for rod in self._rods]),
            **self._ball_state(),
            time=self._time,
        )

    def _ball_state(self) -> dict[str, FloatArray]:
        """Fields of a state that are the ball's."""
        ball = self._ball
        if ball is None:
            return {}
        moving = (ball.position_collection, ball.velocity_collection, ball.omega_collection)
        return {
            f"bolus_{name}": of.T.copy() for name, of in zip(("position", "velocity", "omega"), moving, strict=True)
        }

    def restore(self, state: RodState) -> None:
        """Take over a state."""
        for index, rod in enumerate(self._rods):
            nodes, elements = self.model.nodes(index), self.model.elements(index)
            rod.position_collection[:] = state.position[nodes].T
            rod.velocity_collection[:] = state.velocity[nodes].T
            rod.director_collection[:] = np.moveaxis(state.directors[elements], 0, -1)
            rod.omega_collection[:] = state.omega[elements].T
            _clear(rod)
        if (ball := self._ball) is not None:
            ball.position_collection[:] = state.bolus_position.T
            ball.velocity_collection[:] = state.bolus_velocity.T
            ball.omega_collection[:] = state.bolus_omega.T
            _clear(ball)
        self._time = state.time

    def advance(self, start: FloatArray, end: FloatArray, n_substeps: int) -> Health:
        """Advance with tensions from `start` to `end` [N], shape (n_muscle,)."""
        self._gone[:] = 0.0
        # A state that blows up overflows on its way; the health check names it, numpy need not.
        with np.errstate(all="ignore"):
            for step in range(n_substeps):
                self._tension[:, 0] = start + (end - start) * ((step + 0.5) / n_substeps)
                before = None if not self._energy_check else (self._muscle_length(), self.state)
                self._stepper.step(self._simulator, self._time, self.dt)
                self._time += self.dt
                if before is not None:
                    length, state = before
                    work = float(self._acting @ (length - self._muscle_length()))
                    self._gone += np.array(
                        [work, self._torque_work(state), self._loss(state) + self._ground_loss(state)]
                    )
                if self._ball is not None:
                    self._square_ball(self._ball)
        return self._health()

    def _square_ball(self, ball: Sphere) -> None:
        """Turn the ball's frame back to the laboratory's: how it lies makes no difference, and no state holds it."""
        frame = ball.director_collection[..., 0]
        ball.omega_collection[:, 0] = frame.T @ ball.omega_collection[:, 0]
        ball.director_collection[..., 0] = np.eye(3)

    def flow(self) -> Flow:
        """Energy that entered and left in the last call."""
        return Flow(*self._gone.tolist())

    def _muscle_length(self) -> FloatArray:
        """Length of every element of a muscle, then of every line, as their nodes stand [m], as `_acting`."""
        rods = [np.linalg.norm(np.diff(self._rods[i].position_collection), axis=0) for i in self.model.muscles]
        lines = [
            np.linalg.norm(
                self._rods[line.rod_b].position_collection[:, line.node_b]
                - self._rods[line.rod_a].position_collection[:, line.node_a]
            )
            for line in self.model.lines
        ]
        return np.concatenate([*rods, lines])

    def _torque_work(self, before: RodState) -> float:
        """Work of the point torques over the step just taken [J], at the mean spin."""
        work = 0.0
        for load in self.model.torques:
            early = before.omega[self.model.elements(load.rod)][load.element]
            work += (
                0.5 * self.dt * float((early + self._rods[load.rod].omega_collection[:, load.element]) @ load.torque)
            )
        return work

    def _loss(self, before: RodState) -> float:
        """Energy that damping took in the step just taken [J].

        A kick by the force f, then a velocity scaled by D: f u_mean dt, with u_mean the mean of the velocities before
        and after the step, goes into kinetic energy but for m / 2 (1/D - 1) (u' + u) u'.
        """
        lost = self.dt * float(self._contact_loss[0])
        self._contact_loss[:] = 0.0
        for index, (rod, made) in enumerate(zip(self.model.rods, self._rods, strict=True)):
            nodes = self.model.nodes(index)
            mass, damping = self.model.node_mass[nodes], self.model.node_damping[nodes]
            late, early = made.velocity_collection, before.velocity[nodes].T
            rate = np.minimum(self.dt * damping / mass, _LARGEST_RATE)
            lost += float(0.5 * mass * np.expm1(rate) @ (late * (late + early)).sum(axis=0))
            spin, early = made.omega_collection, before.omega[self.model.elements(index)].T
            rate = np.minimum(self.dt * rod.rotational_damping / rod.inertia * made.dilatation, _LARGEST_RATE)
            across, along = 0.5 * np.expm1(rate), np.expm1(0.5 * rate)
            both = spin * (spin + early)
            lost += float(rod.inertia / made.dilatation @ (across * (both[0] + both[1]) + along * both[2]))
        for joint in self.model.joints:
            a, b = (int(self.model.node_offset[rod]) for rod in (joint.rod_a, joint.rod_b))
            early_rate = before.velocity[b + joint.node_b] - before.velocity[a + joint.node_a]
            rate = (
                self._rods[joint.rod_b].velocity_collection[:, joint.node_b]
                - self._rods[joint.rod_a].velocity_collection[:, joint.node_a]
            )
            lost += 0.5 * self.dt * joint.damping * float(early_rate @ (early_rate + rate))
        return lost

    def _ground_loss(self, before: RodState) -> float:
        """Energy that dashpots and friction of the ground took in the step just taken [J], at the mean velocity."""
        power = 0.0
        for index, footing in enumerate(self._footing):
            mean = 0.5 * (before.velocity[self.model.nodes(index)].T + self._rods[index].velocity_collection)
            power += float((footing.dashpot * mean[2]).sum() + (footing.friction * mean[:2]).sum())
        return -self.dt * power

    def _health(self) -> Health:
        """Status of the first rod and element found at fault."""
        for index, rod in enumerate(self._rods):
            position, velocity, directors = rod.position_collection, rod.velocity_collection, rod.director_collection
            side = np.diff(position, axis=1)
            with np.errstate(all="ignore"):
                finite = np.isfinite(side).all(0) & np.isfinite(np.diff(velocity, axis=1)).all(0)
                finite &= np.isfinite(directors).all((0, 1)) & np.isfinite(rod.omega_collection).all(0)
                dilatation = np.linalg.norm(side, axis=0) / rod.rest_lengths
                stretched = (dilatation < MIN_DILATATION) | (dilatation > MAX_DILATATION)
                inverted = np.sum(directors[2] * side, axis=0) <= 0.0
            status = np.select(
                [~finite, stretched, inverted], [Status.NON_FINITE, Status.OVERSTRETCHED, Status.INVERTED], Status.OK
            )
            if status.any():
                element = int(np.argmax(status != Status.OK))
                return Health(Status(int(status[element])), index, element)
        for k, joint in enumerate(self.model.joints):
            a = self._rods[joint.rod_a].position_collection[:, joint.node_a]
            b = self._rods[joint.rod_b].position_collection[:, joint.node_b]
            if not np.linalg.norm(b - a) <= self._reach[k]:
                return torn(self.model, k)
        lengths = self._muscle_length()[self._n_pulled :]
        for k, (line, length) in enumerate(zip(self.model.lines, lengths, strict=True)):
            if not MIN_DILATATION <= length / line.rest_length <= MAX_DILATATION:
                return overstretched(self.model, k)
        lost = any(not np.isfinite(value).all() for value in self._ball_state().values())
        return Health(Status.NON_FINITE if lost else Status.OK)


class PyElasticaEngine(Engine):
    """Assemblies in PyElastica 1.0.0, one after another."""

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
        if splitting != "pyelastica":
            raise ValueError(f"splitting = {splitting!r}: the pyelastica engine damps as PyElastica does; take fused")
        self._worms = [Assembly(model, self.dt, energy_check) for model in self.models]
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
        self._worms[worm] = Assembly(model, self.dt, self.energy_check)

    def _flow(self, worm: int) -> Flow:
        return self._worms[worm].flow()
