"""All compiled code of the fused engine: one position-Verlet step of a whole rod assembly.

Rods with the same element count stand side by side in `LANES` lanes of one *block*: record n of a block holds
node n, element n and the Voronoi region between elements n and n + 1 of each of its rods. Every field of the
structured dtype has a compile-time offset, so LLVM proves that fields do not alias and turns each
`for j in range(LANES)` loop into packed instructions. A spare lane holds a copy of a rod that neither moves nor turns.
No lane feels another: rods of several worms share blocks, and each moves to the last bit as in any other company.

The equations are those of Gazzola et al. 2018 (R. Soc. Open Sci. 5:171628) as PyElastica 1.0.0 discretises them:
circular sections (so J3 = 2 J1), linear elasticity, volume-preserving stretch. Within a step, in this order: weights
and point forces (what a force starts from), joints, lines, the ball's push, rods that touch, internal forces and muscle
tension, the ground's normal force, kick, the ground's friction, the ball's, drift; damping goes along with the kick or
comes after it, see `engines.Splitting`. The half drift that ends a step and the one that begins the next are one full
drift; the first and the last of a call are halves.

All of this stands in one file because numba's cache looks at one file only: a helper elsewhere could be edited
and the old machine code would run on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
import numpy.typing as npt
from numba import float64, njit
from numba.extending import intrinsic

LANES = 16


def _record(**fields: int) -> np.dtype[np.void]:
    """Record of fields by their number of components; `x[i, lane]`, or `rest[lane]` of a single one."""
    return np.dtype([(name, np.float64, (n, LANES) if n > 1 else (LANES,)) for name, n in fields.items()])


CELL = _record(
    # node
    x=3, v=3, force=3, push=1, keep=1,
    # element
    q=9, w=3, rest=1, shear=1, stretch=1, spin_kick=1, spin_decay=1,
    # Voronoi region
    bend=1, twist=1, rest_turn=3,
    # only where the scene has them
    tension=1, tension_rise=1, inv_rest=1, couple=3, load=3, height=1,
)  # fmt: skip
"""One record of a block."""

WORK = _record(
    arm=2, passed=3, length=1, stretch_rate=1, lean=3, spin_keep=1, spin_late=1, half_angle=1,
    square=1, sine=1, versine=1,
)  # fmt: skip
"""What is known of an element within a step. Two records are enough to step with: they stay in the fastest memory."""

Cells = npt.NDArray[Any]
FloatArray = npt.NDArray[np.float64]
Function = TypeVar("Function", bound=Callable[..., Any])


class Joints(NamedTuple):
    """Spherical joints between two nodes: record and lane of each, stiffness [N/m], each of shape (n_joint,)."""

    cell_a: npt.NDArray[np.int64]
    lane_a: npt.NDArray[np.int64]
    cell_b: npt.NDArray[np.int64]
    lane_b: npt.NDArray[np.int64]
    stiffness: npt.NDArray[np.float64]


class Lines(NamedTuple):
    """Massless muscles between two nodes, as `Joints`, each of shape (n_line,): rest length [m], E A [N], tension [N].

    The tension is advanced in place by its rise at every step.
    """

    cell_a: npt.NDArray[np.int64]
    lane_a: npt.NDArray[np.int64]
    cell_b: npt.NDArray[np.int64]
    lane_b: npt.NDArray[np.int64]
    rest_length: npt.NDArray[np.float64]
    stiffness: npt.NDArray[np.float64]
    tension: npt.NDArray[np.float64]
    rise: npt.NDArray[np.float64]


class Hill(NamedTuple):
    """Constants of `hill.Hill`: inverse width, optimal length, maximal speed [s] and A; M; c.

    Where a factor is absent its inverse width, or its inverse speed, is 0.
    """

    inv_width: float
    inv_optimal: float
    inv_speed: float
    inv_curvature: float
    eccentric: float
    rise: float


class Axis(NamedTuple):
    """How the body lies: the unit vector from the mean of some nodes to that of others, `along`, shape (3,), in place.

    Records and lanes of either are given, shape (n,) each.
    """

    cell_a: npt.NDArray[np.int64]
    lane_a: npt.NDArray[np.int64]
    cell_b: npt.NDArray[np.int64]
    lane_b: npt.NDArray[np.int64]
    along: npt.NDArray[np.float64]


class Ground(NamedTuple):
    """The plane z = 0: spring [N/m] and dashpot [N s/m] of a node, Coulomb's coefficients of friction.

    `forward`, `backward` and `sideways` are factors on both coefficients for slip along the body axis, against it and
    across. The axis is None where they are alike.
    """

    stiffness: float
    damping: float
    static_friction: float
    kinetic_friction: float
    forward: float
    backward: float
    sideways: float
    axis: Axis | None


TOUCH = np.dtype(
    [(name, np.int64) for name in ("cell", "lane", "first", "second")]
    + [(name, np.float64) for name in ("far", "near_push", "far_push", "inv_give", "most")]
    + [(name, np.float64, (3,)) for name in ("gap", "normal", "early", "drag")]
)
"""An element that the ball rubs on in this step: record, lane, rows of its nodes in `Ball.nodes`, share of the second.

A unit of friction [N] adds `near_push` and `far_push` to the velocities of its nodes in the step, and changes the slip
there by one over `inv_give`; it can be at most `most` [N]. `gap` leads from the centre line to the ball's centre [m],
along `normal`; `early` is the slip before the kick [m/s], `drag` the friction on the ball [N].
"""


class Ball(NamedTuple):
    """The rigid ball: position [m], velocity [m/s], angular velocity [rad/s] and constant force [N], shape (3,) each.

    `reach` has the radii of ball and element together, by record and lane [m], shape (n_cell, LANES), 0 where there is
    nothing to touch. `cell` and `lane` are those of every element in the order of the model, shape (n_elem,). A unit of
    force adds `kick` to its velocity in a step, a unit of torque `spin_kick` to its spin. Work space: `load`, the force
    of the contacts but for friction [N], shape (3,); `close`, whether it overlaps any element of a record, shape
    (n_cell,); `touches`, shape (n_elem,); and velocities of the nodes that it rubs on [m/s], shape (2 n_elem, 3).
    """

    place: npt.NDArray[np.float64]
    speed: npt.NDArray[np.float64]
    spin: npt.NDArray[np.float64]
    force: npt.NDArray[np.float64]
    load: npt.NDArray[np.float64]
    reach: npt.NDArray[np.float64]
    close: npt.NDArray[np.bool_]
    cell: npt.NDArray[np.int64]
    lane: npt.NDArray[np.int64]
    touches: npt.NDArray[Any]
    nodes: npt.NDArray[np.float64]
    kick: float
    spin_kick: float
    stiffness: float
    damping: float
    friction: float


class Contact(NamedTuple):
    """Elements that may touch, as `lattice_gym.contact` has it: record, lane, rod and radius [m], shape (n,) each.

    Those that element i never touches are `never[row[i] : row[i + 1]]`, all beyond i. Elements nearer than their radii
    and the `skin` [m] are listed, again once a node has gone more than half the skin from where it was then, `listed`
    [m], shape (n, 2, 3), infinite where none is; `ends` are where they are now. An element beyond the length `longest`
    [m] has diverged and is not listed. `pairs` has the list, `used` how many rows of it there are, shape (1,). Work
    space of the listing: `grid`, shape (n, 3), `behind`, shape (n,), and `head`, whose size is a power of two.
    """

    cell: npt.NDArray[np.int64]
    lane: npt.NDArray[np.int64]
    rod: npt.NDArray[np.int64]
    radius: npt.NDArray[np.float64]
    never: npt.NDArray[np.int64]
    row: npt.NDArray[np.int64]
    listed: npt.NDArray[np.float64]
    ends: npt.NDArray[np.float64]
    pairs: npt.NDArray[np.int64]
    used: npt.NDArray[np.int64]
    grid: npt.NDArray[np.int64]
    head: npt.NDArray[np.int64]
    behind: npt.NDArray[np.int64]
    stiffness: float
    damping: float
    skin: float
    longest: float


class Account(NamedTuple):
    """Energy that enters and leaves, added up step by step for whoever asks; see `_account`.

    `total` is the work of the muscles and of torques, and what was dissipated [J], shape (3,). By record and lane,
    shape (n_cell, LANES): what damping takes from a node, per square of its speed after the kick (`after`) and before
    (`before`) and per product of both (`mixed`) [kg], the inertia of an element [kg m^2], and of muscles the length [m]
    and the tension that acted [N] at the moment last counted; with components, shape (n_cell, 3, LANES): velocities and
    spins at the step before, and what of the force of the ground on a node is of its friction and dashpot (`held`) [N].
    `line` and `line_pull` are length and tension of the lines, shape (n_line,).
    """

    total: npt.NDArray[np.float64]
    after: npt.NDArray[np.float64]
    before: npt.NDArray[np.float64]
    mixed: npt.NDArray[np.float64]
    inertia: npt.NDArray[np.float64]
    length: npt.NDArray[np.float64]
    pull: npt.NDArray[np.float64]
    velocity: npt.NDArray[np.float64]
    omega: npt.NDArray[np.float64]
    held: npt.NDArray[np.float64]
    line: npt.NDArray[np.float64]
    line_pull: npt.NDArray[np.float64]


class Worms(NamedTuple):
    """Who is who among the records: record and lane of every node and element of each worm.

    Shapes (n_worm, n_node) and (n_worm, n_elem); `reach` is the gap at which each joint counts as torn [m], shape
    (n_worm, n_joint). Positions and velocities, shape (n, n_node, 3), are written in the `row` of each worm that is
    sound; `status` (as `engines.Status`) and `found`, the element or joint at fault, shape (n_worm,), for each.
    """

    node_cell: npt.NDArray[np.int64]
    node_lane: npt.NDArray[np.int64]
    cell: npt.NDArray[np.int64]
    lane: npt.NDArray[np.int64]
    reach: npt.NDArray[np.float64]
    row: npt.NDArray[np.int64]
    position: npt.NDArray[np.float64]
    velocity: npt.NDArray[np.float64]
    status: npt.NDArray[np.int64]
    found: npt.NDArray[np.int64]


_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": {"nsz"}}


def compiled(function: Function) -> Function:
    """Compile with no licence but to forget the sign of a zero: NaN must show, and nothing be reordered or fused.

    What the compiler unrolls it would order and fuse differently from one half of the lanes to the other, and how a rod
    moves would depend on its lane: products that are to be fused say so, see `fma`.
    """
    return cast(Function, njit(**_OPTIONS)(function))


def inlined(function: Function) -> Function:
    """Compile as `compiled` into whatever calls it: an array takes more instructions to pass than a lane to compute."""
    return cast(Function, njit(**_OPTIONS, forceinline=True)(function))


def compiled_strictly(function: Function) -> Function:
    """Compile with no licence at all: in loops that branch lane by lane, and where NaN is looked for."""
    return cast(Function, njit(cache=True, error_model="numpy")(function))


def entry(function: Function) -> Function:
    """Compile what Python calls: it lets other threads run meanwhile."""
    return cast(Function, njit(cache=True, error_model="numpy", nogil=True)(function))


def _fma(_: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once.

    Where the processor has no such instruction the C library does it: to the same bits, but many times slower.
    """
    return float64(float64, float64, float64), lambda context, builder, signature, values: builder.fma(*values)


fma = cast(Callable[[float, float, float], float], intrinsic(_fma))


def _series(function: Callable[[FloatArray], FloatArray], degree: int, top: float) -> tuple[float, ...]:
    """Coefficients of the polynomial through a function at the Chebyshev points of [0, top]."""
    fit = np.polynomial.Chebyshev.interpolate(function, degree, (0.0, top))
    return tuple(fit.convert(kind=np.polynomial.Polynomial, domain=(-1.0, 1.0), window=(-1.0, 1.0)).coef.tolist())


# Each is exact to rounding up to where it ends. Of y = sin^2(angle / 2), angle / sin(angle) up to 35 degrees:
_LARGE_Y = 0.09
_ARC = _series(lambda y: np.arcsin(np.sqrt(y)) / np.sqrt(y * (1.0 - y)), 9, _LARGE_Y)
_LARGE_HALF = 0.25 * float(np.polynomial.polynomial.polyval(_LARGE_Y, _ARC))
# Of t^2, sin(t) / t and (1 - cos(t)) / t^2:
_LARGE_T2 = 0.25
_SINE = _series(lambda t2: np.sin(np.sqrt(t2)) / np.sqrt(t2), 5, _LARGE_T2)
_VERSINE = _series(lambda t2: 2.0 * np.sin(0.5 * np.sqrt(t2)) ** 2 / t2, 5, _LARGE_T2)
# Of y, (1 - exp(-y)) / y:
_LARGE_DECAY = 0.25
_TAIL = _series(lambda y: -np.expm1(-y) / y, 8, _LARGE_DECAY)
# Sweeps forth and back over the friction of the ball, at most; they end when none changed by more than this share of
# the largest that may be.
_SWEEPS = 6
_EVEN = 1e-9
_LEAST_SQUARE = 1e-300
# As `contact.PARALLEL`.
_PARALLEL = 1e-12
# Cells of the grid that a coordinate may be away from the origin: what is further has diverged and is not listed.
_FAR_CELL = 1e9
# Spin damped to less than this share within a step is too slow to count; the bound keeps 1 / keep^4 finite.
_LEAST_KEEP = 1e-70


@inlined
def _dot(a0: float, a1: float, a2: float, b0: float, b1: float, b2: float) -> float:
    return float(fma(a2, b2, fma(a1, b1, a0 * b0)))


@inlined
def _hill_factor(dilatation: float, rate: float, hill: Hill) -> float:
    """Force-length times force-velocity of a length over rest length and its rate [1/s].

    The branches for slow and fast are multiplied, as each is 1 where the other holds.
    """
    reach = (dilatation * hill.inv_optimal - 1.0) * hill.inv_width
    speed = rate * hill.inv_speed
    slow, fast = max(min(speed, 0.0), -1.0), hill.rise * max(speed, 0.0)
    upper = (1.0 + slow) * (1.0 + hill.eccentric * fast)
    return float(np.exp(-reach * reach) * upper / ((1.0 - slow * hill.inv_curvature) * (1.0 + fast)))


@inlined
def _stress(
    pair: Cells,
    work: Any,
    tension: float | None,
    hill: Hill | None,
    spin_damping: float | None,
    symmetric: float | None,
) -> None:
    """Stretch and shear of element e: add its force to both nodes, set its torque (material frame) without twist.

    With t the tangent, e the dilatation and S, B the stiffness against shear and stretch the force is
    Q^T diag(S, S, B) (e Q t - d3) / e = S t + [B (e d3.t - 1) - S e d3.t] / e d3, as both directions of shear are
    alike, and its torque Q t x n has no third component.
    """
    here, there = pair[0], pair[1]
    x0, x1, v0, v1, q, f0, f1 = here.x, there.x, here.v, there.v, here.q, here.force, there.force
    rest, shear, stretch, lean, arm = here.rest, here.shear, here.stretch, work.lean, work.arm
    length, stretch_rate, inv_rest = work.length, work.stretch_rate, here.inv_rest
    pull, rise = here.tension, here.tension_rise
    decay, spin_keep, spin_late = here.spin_decay, work.spin_keep, work.spin_late
    n_large = 0
    for j in range(LANES):
        dx, dy, dz = x1[0, j] - x0[0, j], x1[1, j] - x0[1, j], x1[2, j] - x0[2, j]
        square = _dot(dx, dy, dz, dx, dy, dz)
        inverse = 1.0 / np.sqrt(square)
        size, inverse_square = square * inverse, inverse * inverse
        du, dv, dw = v1[0, j] - v0[0, j], v1[1, j] - v0[1, j], v1[2, j] - v0[2, j]
        rate = _dot(du, dv, dw, dx, dy, dz) * inverse_square
        length[j], stretch_rate[j] = size, rate
        if symmetric is not None:
            lean[0, j], lean[1, j], lean[2, j] = dx * inverse_square, dy * inverse_square, dz * inverse_square
        if spin_damping is not None:
            y = decay[j] * size
            tail = _exp_tail(y)
            spin_keep[j] = fma(-y, tail, 1.0)
            if symmetric is not None:
                spin_late[j] = tail
            n_large += 1 if y > _LARGE_DECAY else 0
        a = _dot(q[0, j], q[1, j], q[2, j], dx, dy, dz)
        b = _dot(q[3, j], q[4, j], q[5, j], dx, dy, dz)
        c = _dot(q[6, j], q[7, j], q[8, j], dx, dy, dz)
        across = fma(stretch[j], c - rest[j], -(shear[j] * c)) * inverse
        arm[0, j], arm[1, j] = b * across, -(a * across)
        along = shear[j]
        if tension is not None:
            now = pull[j]
            if hill is not None:
                now *= _hill_factor(size * inv_rest[j], rate * (size * inv_rest[j]), hill)
            along += now
            pull[j] += rise[j]
        along *= inverse
        s0, s1, s2 = (
            fma(q[6, j], across, dx * along),
            fma(q[7, j], across, dy * along),
            fma(q[8, j], across, dz * along),
        )
        f0[0, j] += s0
        f0[1, j] += s1
        f0[2, j] += s2
        f1[0, j] -= s0
        f1[1, j] -= s1
        f1[2, j] -= s2
    if n_large > 0:
        _large_decay(here, work, symmetric)


@inlined
def _exp_tail(y: float) -> float:
    """Series of (1 - exp(-y)) / y."""
    y2 = y * y
    low = fma(y2, fma(_TAIL[3], y, _TAIL[2]), fma(_TAIL[1], y, _TAIL[0]))
    high = fma(y2, fma(_TAIL[7], y, _TAIL[6]), fma(_TAIL[5], y, _TAIL[4]))
    return float(fma(y2 * y2, fma(y2 * y2, _TAIL[8], high), low))


@compiled_strictly
def _large_decay(here: Any, work: Any, symmetric: float | None) -> None:
    """Write what damping leaves of the spin of element e where the series does not reach."""
    for j in range(LANES):
        y = here.spin_decay[j] * work.length[j]
        if y > _LARGE_DECAY:
            work.spin_keep[j] = np.exp(-y)
            if symmetric is not None:
                work.spin_late[j] = (1.0 - np.exp(-y)) / y


@inlined
def _half_angle(pair: Cells, work: Any) -> None:
    """Write angle / (4 sin(angle)) between elements e and e + 1."""
    p, q, half_angle = pair[0].q, pair[1].q, work.half_angle
    n_large = 0
    for j in range(LANES):
        first = _dot(q[0, j], q[1, j], q[2, j], p[0, j], p[1, j], p[2, j])
        second = _dot(q[3, j], q[4, j], q[5, j], p[3, j], p[4, j], p[5, j])
        third = _dot(q[6, j], q[7, j], q[8, j], p[6, j], p[7, j], p[8, j])
        y = fma(-0.25, first + second + third, 0.75)
        y2 = y * y
        low = fma(y2, fma(_ARC[3], y, _ARC[2]), fma(_ARC[1], y, _ARC[0]))
        high = fma(y2, fma(_ARC[7], y, _ARC[6]), fma(_ARC[5], y, _ARC[4]))
        y4 = y2 * y2
        half = 0.25 * fma(y4, fma(y4, fma(_ARC[9], y, _ARC[8]), high), low)
        half_angle[j] = half
        n_large += 1 if half > _LARGE_HALF else 0
    if n_large > 0:
        _large_half_angle(pair, work)


@compiled_strictly
def _large_half_angle(pair: Cells, work: Any) -> None:
    """Write angle / (4 sin(angle)) between elements e and e + 1 into half_angle where the series does not reach."""
    here, there = pair[0], pair[1]
    p, q, half_angle = here.q, there.q, work.half_angle
    for j in range(LANES):
        # By what the series gave: a trace summed anew may round otherwise, and then another lane would decide.
        if half_angle[j] > _LARGE_HALF:
            trace = 0.0
            for i in range(9):
                trace += q[i, j] * p[i, j]
            y = min(0.75 - 0.25 * trace, 1.0 - 1e-15)
            half_angle[j] = 0.25 * np.arcsin(np.sqrt(y)) / np.sqrt(y * (1.0 - y))


@inlined
def _move_node(
    here: Any, drift: float, loads: float | None, ground: Ground | None, account: Account | None, n: int
) -> None:
    """Kick, damp and drift node n, and reset its force to its constant load for the next step."""
    x, v, force, push, keep, load = here.x, here.v, here.force, here.push, here.keep, here.load
    if ground is not None:
        _kick_on_ground(here, ground, account, n)
    for j in range(LANES):
        if ground is not None:
            u0, u1, u2 = v[0, j], v[1, j], v[2, j]
        else:
            u0 = fma(force[0, j], push[j], v[0, j] * keep[j])
            u1 = fma(force[1, j], push[j], v[1, j] * keep[j])
            u2 = fma(force[2, j], push[j], v[2, j] * keep[j])
        f0, f1, f2 = 0.0, 0.0, 0.0
        if loads is not None:
            f0, f1, f2 = load[0, j], load[1, j], load[2, j]
        v[0, j], x[0, j], force[0, j] = u0, fma(drift, u0, x[0, j]), f0
        v[1, j], x[1, j], force[1, j] = u1, fma(drift, u1, x[1, j]), f1
        v[2, j], x[2, j], force[2, j] = u2, fma(drift, u2, x[2, j]), f2


@compiled
def _find_axis(cells: Cells, axis: Axis | None) -> None:
    """Write the body axis as its nodes stand."""
    if axis is not None:
        square = 0.0
        for i in range(3):
            way = 0.0
            for n in range(axis.cell_a.shape[0]):
                way += cells[axis.cell_b[n]].x[i, axis.lane_b[n]] - cells[axis.cell_a[n]].x[i, axis.lane_a[n]]
            axis.along[i] = way
            square += way * way
        axis.along[:] /= np.sqrt(square)


@inlined
def _resisted(u0: float, u1: float, ground: Ground, axis: Axis | None) -> float:
    """Speed of a slip times the factor that friction has in its direction, see `world.Ground`."""
    a, b = u0, u1
    if axis is not None:
        e = axis.along
        a = u0 * e[0] + u1 * e[1]
        # Across, and what a tilted axis leaves of the slip: the root of slip^2 - a^2 without the loss of digits.
        b = np.sqrt((u1 * e[0] - u0 * e[1]) ** 2 + e[2] * e[2] * (u0 * u0 + u1 * u1))
    a *= ground.forward if a > 0.0 else ground.backward
    b *= ground.sideways
    return float(np.sqrt(a * a + b * b))


@compiled
def _kick_on_ground(here: Any, ground: Ground, account: Account | None, n: int) -> None:
    """Kick and damp node n, borne and held back by the ground.

    The normal force is that of a spring and a dashpot, but never pulls; it takes the velocity before the kick. It
    bounds the friction, which takes from the velocity after the kick and the damping: all of it where that is within
    its reach (the node sticks), else as much as it can. So it balances the sum of all other forces, and feeds nothing.
    What it took is noted for the account, not yet its work: the ball's friction may change the velocity again.
    """
    x, v, force, push, keep, height = here.x, here.v, here.force, here.push, here.keep, here.height
    for j in range(LANES):
        depth = height[j] - x[2, j]
        bare = ground.stiffness * depth
        normal = bare - ground.damping * v[2, j]
        normal = normal if depth > 0.0 and normal > 0.0 else 0.0
        u0 = v[0, j] * keep[j] + force[0, j] * push[j]
        u1 = v[1, j] * keep[j] + force[1, j] * push[j]
        u2 = v[2, j] * keep[j] + (force[2, j] + normal) * push[j]
        slip = u0 * u0 + u1 * u1
        grip = _resisted(u0, u1, ground, ground.axis) * normal * push[j]
        left = 1.0 - ground.kinetic_friction * grip / slip if slip > ground.static_friction * grip else 0.0
        if account is not None:
            share = (left - 1.0) / push[j] if push[j] > 0.0 else 0.0
            account.held[n, 0, j], account.held[n, 1, j] = share * u0, share * u1
            account.held[n, 2, j] = normal - (bare if depth > 0.0 else 0.0)
        v[0, j], v[1, j], v[2, j] = left * u0, left * u1, u2


@inlined
def _spin_element(
    pair: Cells,
    work: Any,
    after: Any,
    dt: float,
    drift: float,
    bends: float | None,
    couples: float | None,
    spin_damping: float | None,
    symmetric: float | None,
) -> None:
    """Kick and damp the angular velocity w of element e, by the couple of bend and twist to e + 1 if it `bends`.

    What it does to element e + 1 is passed on. With 2 u the rotation vector between both elements, t = 2 B (u - u_rest)
    / (rest e^3), e the dilatation of the Voronoi region, the couple on element e is u x t + t, on e + 1 u x t - t.

    An element turns faster as it stretches. Two terms depend on the velocities themselves: J^-1 [(J w) x w], which is
    (-w1 w2, w0 w2, 0) for J3 = 2 J1 and turns (w0, w1) about d3, and w times the rate of stretch, for J / e bears the
    spin. PyElastica adds both as they stand before the kick: first order, and (w0, w1) grow longer, which feeds fast
    spin. The symmetric step turns (w0, w1) halfway through the kick by the mean of w2, and takes half the stretch from
    before and half from after the kick.
    """
    here, there = pair[0], pair[1]
    p, q, la, lb, half_angle, on = here.q, there.q, work.length, after.length, work.half_angle, after.passed
    bend, twist, rest_turn = here.bend, here.twist, here.rest_turn
    w, arm, passed, couple, rate, lean = here.w, work.arm, work.passed, here.couple, work.stretch_rate, work.lean
    v0, v1, spin_kick, keep, late = here.v, there.v, here.spin_kick, work.spin_keep, work.spin_late
    square, sine, versine, n_large = work.square, work.sine, work.versine, 0
    for j in range(LANES):
        m0, m1, m2 = arm[0, j] + passed[0, j], arm[1, j] + passed[1, j], passed[2, j]
        if couples is not None:
            m0, m1, m2 = m0 + couple[0, j], m1 + couple[1, j], m2 + couple[2, j]
        if bends is not None:
            u0 = half_angle[j] * (
                _dot(q[3, j], q[4, j], q[5, j], p[6, j], p[7, j], p[8, j])
                - _dot(q[6, j], q[7, j], q[8, j], p[3, j], p[4, j], p[5, j])
            )
            u1 = half_angle[j] * (
                _dot(q[6, j], q[7, j], q[8, j], p[0, j], p[1, j], p[2, j])
                - _dot(q[0, j], q[1, j], q[2, j], p[6, j], p[7, j], p[8, j])
            )
            u2 = half_angle[j] * (
                _dot(q[0, j], q[1, j], q[2, j], p[3, j], p[4, j], p[5, j])
                - _dot(q[3, j], q[4, j], q[5, j], p[0, j], p[1, j], p[2, j])
            )
            reach = la[j] + lb[j]
            cube = 1.0 / (reach * reach * reach)
            across, around = bend[j] * cube, twist[j] * cube
            t0, t1, t2 = (
                across * (u0 - rest_turn[0, j]),
                across * (u1 - rest_turn[1, j]),
                around * (u2 - rest_turn[2, j]),
            )
            z0, z1, z2 = fma(u1, t2, -(u2 * t1)), fma(u2, t0, -(u0 * t2)), fma(u0, t1, -(u1 * t0))
            m0, m1, m2 = m0 + (z0 + t0), m1 + (z1 + t1), m2 + (z2 + t2)
            on[0, j], on[1, j], on[2, j] = z0 - t0, z1 - t1, z2 - t2
        w0, w1, w2 = w[0, j], w[1, j], w[2, j]
        scale = la[j] * spin_kick[j]
        h0, h1, h2 = m0 * scale, m1 * scale, 0.5 * m2 * scale
        if symmetric is not None:
            early = 1.0 / fma(-0.5 * dt, rate[j], 1.0)
            a0, a1, a2 = w0 * early, w1 * early, w2 * early
            if spin_damping is not None:
                aside = fma(0.5, keep[j], 0.5) * late[j]
                h0, h1, h2 = h0 * aside, h1 * aside, h2 * late[j]
                a0, a1, a2 = a0 * keep[j] * keep[j], a1 * keep[j] * keep[j], a2 * keep[j]
            t = 0.25 * dt * (fma(w2, early, a2) + h2)
            s = 2.0 * t / fma(t, t, 1.0)
            m0, m1 = fma(0.5, h0, a0), fma(0.5, h1, a1)
            du, dv, dw = v1[0, j] - v0[0, j], v1[1, j] - v0[1, j], v1[2, j] - v0[2, j]
            grow = fma(0.5 * dt, _dot(du, dv, dw, lean[0, j], lean[1, j], lean[2, j]), 1.0)
            z0 = fma(0.5, h0, fma(-s, fma(t, m0, m1), m0)) * grow
            z1 = fma(0.5, h1, fma(s, fma(-t, m1, m0), m1)) * grow
            z2 = (a2 + h2) * grow
        else:
            grow, turn = fma(dt, rate[j], 1.0), dt * w2
            z0, z1, z2 = fma(w0, grow, fma(-turn, w1, h0)), fma(w1, grow, fma(turn, w0, h1)), fma(w2, grow, h2)
            if spin_damping is not None:
                aside = keep[j] * keep[j]
                z0, z1, z2 = z0 * aside, z1 * aside, z2 * keep[j]
        w[0, j], w[1, j], w[2, j] = z0, z1, z2
        square[j], sine[j], versine[j] = _turn(z0, z1, z2, drift)
        n_large += 1 if square[j] > _LARGE_T2 else 0
    if n_large > 0:
        _large_turn(work)


@inlined
def _turn(w0: float, w1: float, w2: float, drift: float) -> tuple[float, float, float]:
    """Square of the angle t that an element turns by, sin(t) / t and (1 - cos(t)) / t^2, where the series reach."""
    a, b, c = drift * w0, drift * w1, drift * w2
    t2 = _dot(a, b, c, a, b, c)
    t4 = t2 * t2
    low, middle, high = fma(_SINE[1], t2, _SINE[0]), fma(_SINE[3], t2, _SINE[2]), fma(_SINE[5], t2, _SINE[4])
    sine = fma(t4, fma(t4, high, middle), low)
    low, middle, high = (
        fma(_VERSINE[1], t2, _VERSINE[0]),
        fma(_VERSINE[3], t2, _VERSINE[2]),
        fma(_VERSINE[5], t2, _VERSINE[4]),
    )
    return t2, sine, fma(t4, fma(t4, high, middle), low)


@inlined
def _rotate_element(here: Any, work: Any, drift: float) -> None:
    """Turn the directors of element e by its angular velocity over `drift` seconds."""
    q, w, sine, versine = here.q, here.w, work.sine, work.versine
    for j in range(LANES):
        a, b, c, s = drift * w[0, j], drift * w[1, j], drift * w[2, j], sine[j]
        ka, kb, kc = versine[j] * a, versine[j] * b, versine[j] * c
        r00, r11, r22 = fma(-kb, b, fma(-kc, c, 1.0)), fma(-ka, a, fma(-kc, c, 1.0)), fma(-ka, a, fma(-kb, b, 1.0))
        ab, ac, bc = ka * b, ka * c, kb * c
        r01, r10, r02, r20, r12, r21 = (
            fma(s, c, ab), fma(-s, c, ab), fma(-s, b, ac), fma(s, b, ac), fma(s, a, bc), fma(-s, a, bc),
        )  # fmt: skip
        d0, d1, d2 = q[0, j], q[3, j], q[6, j]
        q[0, j], q[3, j], q[6, j] = (
            _dot(r00, r01, r02, d0, d1, d2), _dot(r10, r11, r12, d0, d1, d2), _dot(r20, r21, r22, d0, d1, d2),
        )  # fmt: skip
        d0, d1, d2 = q[1, j], q[4, j], q[7, j]
        q[1, j], q[4, j], q[7, j] = (
            _dot(r00, r01, r02, d0, d1, d2), _dot(r10, r11, r12, d0, d1, d2), _dot(r20, r21, r22, d0, d1, d2),
        )  # fmt: skip
        d0, d1, d2 = q[2, j], q[5, j], q[8, j]
        q[2, j], q[5, j], q[8, j] = (
            _dot(r00, r01, r02, d0, d1, d2), _dot(r10, r11, r12, d0, d1, d2), _dot(r20, r21, r22, d0, d1, d2),
        )  # fmt: skip


@compiled_strictly
def _large_turn(work: Any) -> None:
    """Write sin(t) / t and (1 - cos t) / t^2 where the series of `_turn` do not reach."""
    square, sine, versine = work.square, work.sine, work.versine
    for j in range(LANES):
        if square[j] > _LARGE_T2:
            t = np.sqrt(square[j])
            sine[j] = np.sin(t) / t
            versine[j] = 2.0 * np.sin(0.5 * t) ** 2 / square[j]


@inlined
def _foresee_turn(here: Any, work: Any, drift: float) -> None:
    """Note what the turn of element e over `drift` seconds is made of."""
    w, square, sine, versine, n_large = here.w, work.square, work.sine, work.versine, 0
    for j in range(LANES):
        square[j], sine[j], versine[j] = _turn(w[0, j], w[1, j], w[2, j], drift)
        n_large += 1 if square[j] > _LARGE_T2 else 0
    if n_large > 0:
        _large_turn(work)


@compiled
def _half_drift(cells: Cells, work: Cells, block: npt.NDArray[np.int64], drift: float) -> None:
    """Drift every node and element of every block by `drift` seconds."""
    for b in range(block.shape[0]):
        rods = cells[block[b, 0] : block[b, 1]]
        n_elem = rods.shape[0] - 1
        for n in range(n_elem + 1):
            x, v = rods[n].x, rods[n].v
            for i in range(3):
                for j in range(LANES):
                    x[i, j] = fma(drift, v[i, j], x[i, j])
        for e in range(n_elem):
            _foresee_turn(rods[e], work[0], drift)
            _rotate_element(rods[e], work[0], drift)


@inlined
def _step_blocks(
    cells: Cells,
    work: Cells,
    block: npt.NDArray[np.int64],
    dt: float,
    drift: float,
    tension: float | None,
    hill: Hill | None,
    couples: float | None,
    spin_damping: float | None,
    symmetric: float | None,
    loads: float | None,
    ground: Ground | None,
    account: Account | None,
) -> None:
    """Advance every block by one kick and one drift in a single pass over its records.

    A node is done once the stress on both its sides is known, an element once both its couples are: the pass works
    two records behind its front, while they are still in the first-level cache.
    """
    mask = work.shape[0] - 1
    for b in range(block.shape[0]):
        first = block[b, 0]
        rods = cells[first : block[b, 1]]
        last = rods.shape[0] - 2
        one = work[first & mask]
        one.passed[:] = 0.0
        _stress(rods[0:2], one, tension, hill, spin_damping, symmetric)
        _move_node(rods[0], drift, loads, ground, account, first)
        for e in range(last):
            one, two = work[(first + e) & mask], work[(first + e + 1) & mask]
            _stress(rods[e + 1 : e + 3], two, tension, hill, spin_damping, symmetric)
            _move_node(rods[e + 1], drift, loads, ground, account, first + e + 1)
            _half_angle(rods[e : e + 2], one)
            _spin_element(rods[e : e + 2], one, two, dt, drift, 1.0, couples, spin_damping, symmetric)
            _rotate_element(rods[e], one, drift)
        _move_node(rods[last + 1], drift, loads, ground, account, first + last + 1)
        one = work[(first + last) & mask]
        _spin_element(rods[last : last + 2], one, one, dt, drift, None, couples, spin_damping, symmetric)
        _rotate_element(rods[last], one, drift)


@inlined
def _apply_joints(cells: Cells, joints: Joints, damping: npt.NDArray[np.float64] | None) -> None:
    """Add each joint's spring (and dashpot, where the scene has one) to the forces on its two nodes."""
    for n in range(joints.cell_a.shape[0]):
        a, b, la, lb = cells[joints.cell_a[n]], cells[joints.cell_b[n]], joints.lane_a[n], joints.lane_b[n]
        for i in range(3):
            force = joints.stiffness[n] * (b.x[i, lb] - a.x[i, la])
            if damping is not None:
                force += damping[n] * (b.v[i, lb] - a.v[i, la])
            a.force[i, la] += force
            b.force[i, lb] -= force


@inlined
def _apply_lines(cells: Cells, lines: Lines, hill: Hill | None) -> None:
    """Pull each line's two nodes together by its tension and by E A (e - 1) / e, the force of a stretched rod."""
    for n in range(lines.cell_a.shape[0]):
        a, b, la, lb = cells[lines.cell_a[n]], cells[lines.cell_b[n]], lines.lane_a[n], lines.lane_b[n]
        dx, dy, dz = b.x[0, lb] - a.x[0, la], b.x[1, lb] - a.x[1, la], b.x[2, lb] - a.x[2, la]
        inverse = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        tension = lines.tension[n]
        if hill is not None:
            du, dv, dw = b.v[0, lb] - a.v[0, la], b.v[1, lb] - a.v[1, la], b.v[2, lb] - a.v[2, la]
            inv_rest, rate = 1.0 / lines.rest_length[n], (du * dx + dv * dy + dw * dz) * inverse
            tension *= _hill_factor(inv_rest / inverse, rate * inv_rest, hill)
        pull = (tension + lines.stiffness[n] * (1.0 - lines.rest_length[n] * inverse)) * inverse
        a.force[0, la] += pull * dx
        a.force[1, la] += pull * dy
        a.force[2, la] += pull * dz
        b.force[0, lb] -= pull * dx
        b.force[1, lb] -= pull * dy
        b.force[2, lb] -= pull * dz
        lines.tension[n] += lines.rise[n]


@compiled
def _find_close(cells: Cells, passive: npt.NDArray[np.int64], active: npt.NDArray[np.int64], ball: Ball) -> bool:
    """Mark the records of which the ball overlaps an element; tell whether there are any."""
    found = False
    c0, c1, c2 = ball.place[0], ball.place[1], ball.place[2]
    for blocks in (passive, active):
        for b in range(blocks.shape[0]):
            for e in range(blocks[b, 0], blocks[b, 1] - 1):
                x0, x1, reach = cells[e].x, cells[e + 1].x, ball.reach[e]
                n_touching = 0
                for j in range(LANES):
                    dx, dy, dz = x1[0, j] - x0[0, j], x1[1, j] - x0[1, j], x1[2, j] - x0[2, j]
                    gx, gy, gz = c0 - x0[0, j], c1 - x0[1, j], c2 - x0[2, j]
                    far = (gx * dx + gy * dy + gz * dz) / (dx * dx + dy * dy + dz * dz)
                    far = min(max(far, 0.0), 1.0)
                    gx, gy, gz = gx - far * dx, gy - far * dy, gz - far * dz
                    n_touching += 1 if gx * gx + gy * gy + gz * gz < reach[j] * reach[j] else 0
                ball.close[e] = n_touching > 0
                found = found or n_touching > 0
    return found


@compiled
def _touch(cells: Cells, ball: Ball) -> tuple[int, float]:
    """Push of the ball on every element of the marked records that it overlaps, as `model.Ball` has it.

    It is added to the forces on both nodes and to the ball's load. Returns the number of elements on which it may rub,
    which are noted in the order of the model, and the power that the dashpots dissipate [W].
    """
    n_touch, lost, load, touches = 0, 0.0, ball.load, ball.touches
    c0, c1, c2 = ball.place[0], ball.place[1], ball.place[2]
    v0, v1, v2 = ball.speed[0], ball.speed[1], ball.speed[2]
    w0, w1, w2 = ball.spin[0], ball.spin[1], ball.spin[2]
    for k in range(ball.cell.shape[0]):
        e, j = ball.cell[k], ball.lane[k]
        if not ball.close[e]:
            continue
        here, there, reach = cells[e], cells[e + 1], ball.reach[e, j]
        x0, x1, u0, u1, f0, f1 = here.x, there.x, here.v, there.v, here.force, there.force
        dx, dy, dz = x1[0, j] - x0[0, j], x1[1, j] - x0[1, j], x1[2, j] - x0[2, j]
        gx, gy, gz = c0 - x0[0, j], c1 - x0[1, j], c2 - x0[2, j]
        far = (gx * dx + gy * dy + gz * dz) / (dx * dx + dy * dy + dz * dz)
        far = min(max(far, 0.0), 1.0)
        near = 1.0 - far
        gx, gy, gz = gx - far * dx, gy - far * dy, gz - far * dz
        square = gx * gx + gy * gy + gz * gz
        if not square < reach * reach:
            continue
        inverse = 1.0 / np.sqrt(max(square, _LEAST_SQUARE))
        nx, ny, nz = gx * inverse, gy * inverse, gz * inverse
        ux = v0 - (w1 * gz - w2 * gy) - (near * u0[0, j] + far * u1[0, j])
        uy = v1 - (w2 * gx - w0 * gz) - (near * u0[1, j] + far * u1[1, j])
        uz = v2 - (w0 * gy - w1 * gx) - (near * u0[2, j] + far * u1[2, j])
        rate = ux * nx + uy * ny + uz * nz
        spring = ball.stiffness * (reach - square * inverse)
        push = max(spring - ball.damping * rate, 0.0)
        lost += (spring - push) * rate
        for i, force in ((0, push * nx), (1, push * ny), (2, push * nz)):
            f0[i, j] -= near * force
            f1[i, j] -= far * force
            load[i] += force
        if ball.friction * push > 0.0:
            touch = touches[n_touch]
            touch.cell, touch.lane, touch.far, touch.most = e, j, far, ball.friction * push
            touch.near_push, touch.far_push = here.push[j] * near, there.push[j] * far
            give = ball.kick + ball.spin_kick * square + near * touch.near_push + far * touch.far_push
            touch.inv_give = 1.0 / give
            gap, normal, early, drag = touch.gap, touch.normal, touch.early, touch.drag
            gap[0], gap[1], gap[2] = gx, gy, gz
            normal[0], normal[1], normal[2] = nx, ny, nz
            early[0], early[1], early[2] = ux - rate * nx, uy - rate * ny, uz - rate * nz
            drag[0], drag[1], drag[2] = 0.0, 0.0, 0.0
            n_touch += 1
    return n_touch, lost


@compiled
def _rub(cells: Cells, ball: Ball, n_touch: int, drift: float) -> float:
    """Friction of the ball on the velocities that all else left; make up for it in what has drifted; its power [W].

    The friction of one touch changes the slip of others. That of all together is the one that leaves the least kinetic
    energy that they can: it takes all slip where it may, and else is full and against it. Sweeps over the touches, each
    in turn as if the others were right, lower that energy every time, so friction feeds nothing however early they end.
    They go forth and back: what they leave then answers to the slip by a symmetric matrix, as a dashpot does. Sweeps in
    one direction leave some that, over many steps, drives what sticks.
    """
    n_node, largest = 0, 0.0
    for k in range(n_touch):
        touch = ball.touches[k]
        before, j = ball.touches[max(k - 1, 0)], touch.lane
        largest = max(largest, touch.most)
        follows = k > 0 and before.cell + 1 == touch.cell and before.lane == j
        touch.first = before.second if follows else n_node
        touch.second = touch.first + 1
        n_node = touch.second + 1
        for i in range(3):
            ball.nodes[touch.first, i] = cells[touch.cell].v[i, j]
            ball.nodes[touch.second, i] = cells[touch.cell + 1].v[i, j]
    for _ in range(_SWEEPS):
        change = _sweep(ball, n_touch, False)
        if not max(change, _sweep(ball, n_touch, True)) > (_EVEN * largest) ** 2:
            break
    lost = 0.0
    for k in range(n_touch):
        touch = ball.touches[k]
        here, there, j = cells[touch.cell], cells[touch.cell + 1], touch.lane
        for i in range(3):
            lost -= 0.5 * touch.drag[i] * (touch.early[i] + _slip(ball, touch, i))
        for i in range(3):
            for node, row in ((here, touch.first), (there, touch.second)):
                node.x[i, j] += drift * (ball.nodes[row, i] - node.v[i, j])
                node.v[i, j] = ball.nodes[row, i]
    for i in range(3):
        ball.place[i] += drift * ball.speed[i]
    return lost


@compiled
def _slip(ball: Ball, touch: Any, i: int) -> float:
    """Component of the velocity of the ball over that of an element where they touch [m/s]."""
    j, k = (i + 1) % 3, (i + 2) % 3
    turning = ball.spin[j] * touch.gap[k] - ball.spin[k] * touch.gap[j]
    near, far = ball.nodes[touch.first, i], ball.nodes[touch.second, i]
    return float(ball.speed[i] - turning - near - touch.far * (far - near))


@compiled
def _sweep(ball: Ball, n_touch: int, back: bool) -> float:
    """Let the friction of each touch take all slip there, if it can, from the first to the last or `back`.

    Returns the square of the largest change [N^2].
    """
    speed, spin, nodes, kick, spin_kick = ball.speed, ball.spin, ball.nodes, ball.kick, ball.spin_kick
    v0, v1, v2, w0, w1, w2 = speed[0], speed[1], speed[2], spin[0], spin[1], spin[2]
    change = 0.0
    for step in range(n_touch):
        touch = ball.touches[n_touch - 1 - step if back else step]
        gap, normal, drag, a, b, far = touch.gap, touch.normal, touch.drag, touch.first, touch.second, touch.far
        g0, g1, g2, n0, n1, n2 = gap[0], gap[1], gap[2], normal[0], normal[1], normal[2]
        a0, a1, a2 = nodes[a, 0], nodes[a, 1], nodes[a, 2]
        b0, b1, b2 = nodes[b, 0], nodes[b, 1], nodes[b, 2]
        u0 = v0 - (w1 * g2 - w2 * g1) - a0 - far * (b0 - a0)
        u1 = v1 - (w2 * g0 - w0 * g2) - a1 - far * (b1 - a1)
        u2 = v2 - (w0 * g1 - w1 * g0) - a2 - far * (b2 - a2)
        rate = u0 * n0 + u1 * n1 + u2 * n2
        f0 = drag[0] - (u0 - rate * n0) * touch.inv_give
        f1 = drag[1] - (u1 - rate * n1) * touch.inv_give
        f2 = drag[2] - (u2 - rate * n2) * touch.inv_give
        size = f0 * f0 + f1 * f1 + f2 * f2
        if size > touch.most * touch.most:
            share = touch.most / np.sqrt(size)
            f0, f1, f2 = share * f0, share * f1, share * f2
        d0, d1, d2 = f0 - drag[0], f1 - drag[1], f2 - drag[2]
        drag[0], drag[1], drag[2] = f0, f1, f2
        change = max(change, d0 * d0 + d1 * d1 + d2 * d2)
        near_push, far_push = touch.near_push, touch.far_push
        nodes[a, 0], nodes[a, 1], nodes[a, 2] = a0 - near_push * d0, a1 - near_push * d1, a2 - near_push * d2
        nodes[b, 0], nodes[b, 1], nodes[b, 2] = b0 - far_push * d0, b1 - far_push * d1, b2 - far_push * d2
        v0, v1, v2 = v0 + kick * d0, v1 + kick * d1, v2 + kick * d2
        w0 -= spin_kick * (g1 * d2 - g2 * d1)
        w1 -= spin_kick * (g2 * d0 - g0 * d2)
        w2 -= spin_kick * (g0 * d1 - g1 * d0)
    speed[0], speed[1], speed[2], spin[0], spin[1], spin[2] = v0, v1, v2, w0, w1, w2
    return change


@compiled
def _nearest(ends: npt.NDArray[np.float64], one: int, two: int) -> tuple[float, float, float, float, float, float]:
    """Shares of two segments where they are nearest, the vector from the second to the first there, and its square.

    Their ends have the shape (n, 2, 3). Ericson 2005, Real-Time Collision Detection, section 5.1.9.
    """
    ax, ay, az = ends[one, 0, 0], ends[one, 0, 1], ends[one, 0, 2]
    bx, by, bz = ends[two, 0, 0], ends[two, 0, 1], ends[two, 0, 2]
    ux, uy, uz = ends[one, 1, 0] - ax, ends[one, 1, 1] - ay, ends[one, 1, 2] - az
    wx, wy, wz = ends[two, 1, 0] - bx, ends[two, 1, 1] - by, ends[two, 1, 2] - bz
    rx, ry, rz = ax - bx, ay - by, az - bz
    uu, ww, uw = ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz, ux * wx + uy * wy + uz * wz
    ur, wr = ux * rx + uy * ry + uz * rz, wx * rx + wy * ry + wz * rz
    turned = uu * ww - uw * uw
    if turned > _PARALLEL * uu * ww:
        s = min(max((uw * wr - ur * ww) / turned, 0.0), 1.0)
    else:
        s = 0.5 * (min(max(-ur / uu, 0.0), 1.0) + min(max((uw - ur) / uu, 0.0), 1.0))
    t = (uw * s + wr) / ww
    if t < 0.0:
        t, s = 0.0, min(max(-ur / uu, 0.0), 1.0)
    elif t > 1.0:
        t, s = 1.0, min(max((uw - ur) / uu, 0.0), 1.0)
    gx, gy, gz = rx + s * ux - t * wx, ry + s * uy - t * wy, rz + s * uz - t * wz
    return s, t, gx, gy, gz, gx * gx + gy * gy + gz * gz


@compiled
def _find_ends(cells: Cells, contact: Contact) -> float:
    """Note where the nodes of every element stand; return the largest square of a way gone since they were listed."""
    most, ends, listed = 0.0, contact.ends, contact.listed
    for e in range(contact.cell.shape[0]):
        here, there, j = cells[contact.cell[e]].x, cells[contact.cell[e] + 1].x, contact.lane[e]
        first, second = 0.0, 0.0
        for i in range(3):
            ends[e, 0, i], ends[e, 1, i] = here[i, j], there[i, j]
            first += (here[i, j] - listed[e, 0, i]) ** 2
            second += (there[i, j] - listed[e, 1, i]) ** 2
        most = max(most, first, second)
    return most


@compiled
def _bucket(x: int, y: int, z: int, size: int) -> int:
    """Place of a cell of the grid in a table whose size is a power of two."""
    return ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (size - 1)


@compiled
def list_pairs(cells: Cells, contact: Contact) -> tuple[npt.NDArray[np.int64], int]:
    """Pairs of elements that may come to touch, as rows of an array, and how many rows it has in use.

    Elements are put into the cells of a grid by their middles; two nearer than their radii and the skin are in cells
    that are neighbours. Where elements stand at all costs no memory: cells share a table. Pairs are in order, so that
    forces add up to the same last bit whenever the list was made.
    """
    n_elem, listed, grid, head, behind = len(contact.cell), contact.listed, contact.grid, contact.head, contact.behind
    rod, radius, skin, never, row = contact.rod, contact.radius, contact.skin, contact.never, contact.row
    _find_ends(cells, contact)
    listed[:] = contact.ends
    longest, thickest, bound = 0.0, 0.0, contact.longest * contact.longest
    for e in range(n_elem):
        square = _square_length(listed, e)
        if square <= bound:
            longest = max(longest, square)
        thickest = max(thickest, radius[e])
    fine = 1.0 / (np.sqrt(longest) + 2.0 * thickest + skin)
    pairs, count = contact.pairs, 0
    head[:] = -1
    for e in range(n_elem):
        sound = _square_length(listed, e) <= bound
        for i in range(3):
            place = np.floor(0.5 * (listed[e, 0, i] + listed[e, 1, i]) * fine)
            sound = sound and abs(place) <= _FAR_CELL
            grid[e, i] = int(place) if sound else 0
        if not sound:
            continue
        x, y, z, first = grid[e, 0], grid[e, 1], grid[e, 2], count
        for near in range(27):
            p, q, r = x + near % 3 - 1, y + near // 3 % 3 - 1, z + near // 9 - 1
            other = head[_bucket(p, q, r, head.shape[0])]
            while other >= 0:
                same = grid[other, 0] == p and grid[other, 1] == q and grid[other, 2] == r
                if (
                    same
                    and rod[other] != rod[e]
                    and _is_near(listed, other, e, radius[other] + radius[e] + skin)
                    and not _is_known(never, row[other], row[other + 1], e)
                ):
                    if count == pairs.shape[0]:
                        more = np.empty((2 * count, 2), np.int64)
                        more[:count] = pairs
                        pairs = more
                    k = count
                    while k > first and pairs[k - 1, 0] > other:
                        pairs[k, 0] = pairs[k - 1, 0]
                        k -= 1
                    pairs[k, 0], pairs[count, 1] = other, e
                    count += 1
                other = behind[other]
        bucket = _bucket(x, y, z, head.shape[0])
        behind[e], head[bucket] = head[bucket], e
    contact.used[0] = count
    return pairs, count


@compiled
def _square_length(listed: npt.NDArray[np.float64], e: int) -> float:
    """Square of the length of a segment."""
    square = 0.0
    for i in range(3):
        square += (listed[e, 1, i] - listed[e, 0, i]) ** 2
    return square


@compiled
def _is_near(listed: npt.NDArray[np.float64], a: int, b: int, reach: float) -> bool:
    """Whether two segments are nearer than `reach`; their middles are then within it and half of either length."""
    apart, own, other = 0.0, 0.0, 0.0
    for i in range(3):
        apart += (listed[a, 0, i] + listed[a, 1, i] - listed[b, 0, i] - listed[b, 1, i]) ** 2
        own += (listed[a, 1, i] - listed[a, 0, i]) ** 2
        other += (listed[b, 1, i] - listed[b, 0, i]) ** 2
    # (p + q)^2 <= 2 p^2 + 2 q^2, twice: no root is needed.
    if apart > 8.0 * reach * reach + 4.0 * (own + other):
        return False
    return bool(_nearest(listed, a, b)[5] < reach * reach)


@compiled
def _is_known(never: npt.NDArray[np.int64], first: int, last: int, b: int) -> bool:
    """Whether b is among never[first:last]."""
    known = False
    for k in range(first, last):
        known = known or never[k] == b
    return known


@compiled
def _press(cells: Cells, contact: Contact, pairs: npt.NDArray[np.int64], count: int) -> float:
    """Add the push of listed elements where they overlap to their nodes; return the power that it dissipates [W]."""
    lost = 0.0
    for k in range(count):
        one, two = pairs[k, 0], pairs[k, 1]
        s, t, gx, gy, gz, square = _nearest(contact.ends, one, two)
        reach = contact.radius[one] + contact.radius[two]
        if not square < reach * reach:
            continue
        inverse = 1.0 / np.sqrt(max(square, _LEAST_SQUARE))
        normal = (gx * inverse, gy * inverse, gz * inverse)
        here_a, there_a, j = cells[contact.cell[one]], cells[contact.cell[one] + 1], contact.lane[one]
        here_b, there_b, m = cells[contact.cell[two]], cells[contact.cell[two] + 1], contact.lane[two]
        rate = 0.0
        for i in range(3):
            speed = (1.0 - s) * here_a.v[i, j] + s * there_a.v[i, j] - (1.0 - t) * here_b.v[i, m] - t * there_b.v[i, m]
            rate += speed * normal[i]
        spring = contact.stiffness * (reach - square * inverse)
        push = max(spring - contact.damping * rate, 0.0)
        for i in range(3):
            force = push * normal[i]
            here_a.force[i, j] += (1.0 - s) * force
            there_a.force[i, j] += s * force
            here_b.force[i, m] -= (1.0 - t) * force
            there_b.force[i, m] -= t * force
        lost += (spring - push) * rate
    return lost


@compiled
def advance(
    cells: Cells,
    work: Cells,
    passive: npt.NDArray[np.int64],
    active: npt.NDArray[np.int64],
    joints: Joints,
    joint_damping: npt.NDArray[np.float64] | None,
    lines: Lines | None,
    hill: Hill | None,
    loads: float | None,
    ground: Ground | None,
    couples: float | None,
    spin_damping: float | None,
    symmetric: float | None,
    ball: Ball | None,
    contact: Contact | None,
    account: Account | None,
    n_steps: int,
    dt: float,
) -> None:
    """Advance the assembly in place by n_steps of position Verlet.

    `passive` and `active` (muscle) blocks are rows (first record, one past the last). What is None is compiled away.
    `work` has two records; for an account one for each of `cells` or more, their number a power of two.
    """
    if account is not None:
        _open_account(cells, account)
        _muscle_work(cells, active, account, hill, False, 0.5)
        if lines is not None:
            _line_work(cells, lines, account, hill, False, 0.5)
    _half_drift(cells, work, passive, 0.5 * dt)
    _half_drift(cells, work, active, 0.5 * dt)
    if ball is not None:
        for i in range(3):
            ball.place[i] += 0.5 * dt * ball.speed[i]
    if contact is not None:
        pairs, n_pairs = contact.pairs, contact.used[0]
    for step in range(n_steps):
        drift = dt if step < n_steps - 1 else 0.5 * dt
        _apply_joints(cells, joints, joint_damping)
        if lines is not None:
            _apply_lines(cells, lines, hill)
            if account is not None:
                _line_work(cells, lines, account, hill, True, 1.0)
        if account is not None:
            _muscle_work(cells, active, account, hill, True, 0.0)
        if ball is not None:
            ball.load[:], n_touch, lost = 0.0, 0, 0.0
            if _find_close(cells, passive, active, ball):
                n_touch, lost = _touch(cells, ball)
            for i in range(3):
                ball.speed[i] += ball.kick * (ball.load[i] + ball.force[i])
            if account is not None:
                account.total[2] += dt * lost
        if contact is not None:
            if _find_ends(cells, contact) > 0.25 * contact.skin * contact.skin:
                pairs, n_pairs = list_pairs(cells, contact)
            lost = _press(cells, contact, pairs, n_pairs)
            if account is not None:
                account.total[2] += dt * lost
        if ground is not None:
            _find_axis(cells, ground.axis)
        _step_blocks(
            cells, work, passive, dt, drift, None, None, couples, spin_damping, symmetric, loads, ground, account
        )
        _step_blocks(
            cells, work, active, dt, drift, 1.0, hill, couples, spin_damping, symmetric, loads, ground, account
        )
        if ball is not None:
            lost = _rub(cells, ball, n_touch, drift)
            if account is not None:
                account.total[2] += dt * lost
        if account is not None:
            if joint_damping is not None:
                _joint_loss(cells, joints, joint_damping, account, dt)
            _account(cells, work, passive, account, couples, spin_damping, symmetric, ground, dt)
            _account(cells, work, active, account, couples, spin_damping, symmetric, ground, dt)
    if contact is not None and n_pairs > len(contact.pairs):
        # The list outgrew its room and is lost with this call.
        contact.listed[:] = np.inf
    if account is not None:
        _muscle_work(cells, active, account, hill, True, 0.5)
        if lines is not None:
            _line_work(cells, lines, account, hill, True, 0.5)


@compiled
def _length(pair: Cells, j: int) -> float:
    """Length of element e of lane j as its nodes stand."""
    square = 0.0
    for i in range(3):
        side = pair[1].x[i, j] - pair[0].x[i, j]
        square += side * side
    return float(np.sqrt(square))


@compiled
def _account(
    cells: Cells,
    work: Cells,
    block: npt.NDArray[np.int64],
    account: Account,
    couples: float | None,
    spin_damping: float | None,
    symmetric: float | None,
    ground: Ground | None,
    dt: float,
) -> None:
    """Add what the step just taken did: work of torques, dissipation.

    Forces work at the mean velocity of a step. A damper that leaves the shares a and b of a velocity before and after
    the kick (`engines.damping_shares`) takes what a force f does so, f (u + u') dt / 2 with u' = a b u + b f dt / m,
    and u' does not show:

        m / 2 [(1/b - 1) u'^2 + (1 - a) u^2 + (1/b - a) u u']
    """
    twist, lost = 0.0, 0.0
    for b in range(block.shape[0]):
        first, last = block[b, 0], block[b, 1] - 1
        for n in range(first, last + 1):
            v, u = cells[n].v, account.velocity[n]
            after, before, mixed = account.after[n], account.before[n], account.mixed[n]
            if ground is not None:
                for i in range(3):
                    for j in range(LANES):
                        lost -= 0.5 * dt * account.held[n, i, j] * (u[i, j] + v[i, j])
            for i in range(3):
                for j in range(LANES):
                    lost += v[i, j] * (after[j] * v[i, j] + mixed[j] * u[i, j]) + before[j] * u[i, j] * u[i, j]
                    u[i, j] = v[i, j]
        for n in range(first, last):
            here, early = cells[n], account.omega[n]
            w, couple = here.w, here.couple
            if couples is not None:
                for i in range(3):
                    for j in range(LANES):
                        twist += 0.5 * dt * couple[i, j] * (early[i, j] + w[i, j])
            if spin_damping is not None:
                lost += _spin_loss(here, work[n], early, account.inertia[n], symmetric)
            for i in range(3):
                for j in range(LANES):
                    early[i, j] = w[i, j]
    account.total[1] += twist
    account.total[2] += lost


@compiled
def _spin_loss(
    here: Any, work: Any, early: npt.NDArray[np.float64], inertia: npt.NDArray[np.float64], symmetric: float | None
) -> float:
    """Energy that damping took from the spin of element e in the step just taken; see `_account`."""
    w, keep, late, length, inv_rest = here.w, work.spin_keep, work.spin_late, work.length, here.inv_rest
    lost = 0.0
    for i in range(3):
        for j in range(LANES):
            left = max(keep[j], _LEAST_KEEP)
            if symmetric is not None:
                after = late[j] if i == 2 else 0.5 * (1.0 + keep[j]) * late[j]
                before = (keep[j] if i == 2 else keep[j] * keep[j]) / after
            else:
                after, before = left if i == 2 else left * left, 1.0
            taken = (1.0 / after - 1.0) * w[i, j] * w[i, j] + (1.0 - before) * early[i, j] * early[i, j]
            taken += (1.0 / after - before) * early[i, j] * w[i, j]
            lost += (1.0 if i == 2 else 0.5) * inertia[j] / (length[j] * inv_rest[j]) * taken
    return lost


@compiled
def _open_account(cells: Cells, account: Account) -> None:
    """Note velocities and spins."""
    for n in range(cells.shape[0]):
        v, w = cells[n].v, cells[n].w
        for i in range(3):
            for j in range(LANES):
                account.velocity[n, i, j], account.omega[n, i, j] = v[i, j], w[i, j]


@compiled
def _muscle_work(
    cells: Cells, active: npt.NDArray[np.int64], account: Account, hill: Hill | None, counts: bool, ago: float
) -> None:
    """Add the work of the muscle rods since the moment last counted, by the trapezoid rule; begin to count from now.

    The tension now is `ago` rises before the one that comes next.
    """
    work = 0.0
    for b in range(active.shape[0]):
        for n in range(active[b, 0], active[b, 1] - 1):
            here, there = cells[n], cells[n + 1]
            for j in range(LANES):
                length, pull = _length(cells[n : n + 2], j), here.tension[j] - ago * here.tension_rise[j]
                if hill is not None:
                    along = 0.0
                    for i in range(3):
                        along += (there.v[i, j] - here.v[i, j]) * (there.x[i, j] - here.x[i, j])
                    inv_rest = here.inv_rest[j]
                    pull *= _hill_factor(length * inv_rest, along / length * inv_rest, hill)
                if counts:
                    work += 0.5 * (account.pull[n, j] + pull) * (account.length[n, j] - length)
                account.length[n, j], account.pull[n, j] = length, pull
    account.total[0] += work


@compiled
def _line_work(cells: Cells, lines: Lines, account: Account, hill: Hill | None, counts: bool, ago: float) -> None:
    """Add the work of the lines, as `_muscle_work` does."""
    for n in range(lines.cell_a.shape[0]):
        a, b, la, lb = cells[lines.cell_a[n]], cells[lines.cell_b[n]], lines.lane_a[n], lines.lane_b[n]
        square, along = 0.0, 0.0
        for i in range(3):
            side = b.x[i, lb] - a.x[i, la]
            square += side * side
            along += (b.v[i, lb] - a.v[i, la]) * side
        length, pull = np.sqrt(square), lines.tension[n] - ago * lines.rise[n]
        if hill is not None:
            inv_rest = 1.0 / lines.rest_length[n]
            pull *= _hill_factor(length * inv_rest, along / length * inv_rest, hill)
        if counts:
            account.total[0] += 0.5 * (account.line_pull[n] + pull) * (account.line[n] - length)
        account.line[n], account.line_pull[n] = length, pull


@compiled
def _joint_loss(cells: Cells, joints: Joints, damping: npt.NDArray[np.float64], account: Account, dt: float) -> None:
    """Add what the joints' dashpots took in the step just taken: they pull with the velocities from before the kick."""
    lost = 0.0
    for n in range(joints.cell_a.shape[0]):
        a, b, la, lb = joints.cell_a[n], joints.cell_b[n], joints.lane_a[n], joints.lane_b[n]
        for i in range(3):
            before = account.velocity[b, i, lb] - account.velocity[a, i, la]
            rate = cells[b].v[i, lb] - cells[a].v[i, la]
            lost += 0.5 * damping[n] * before * (before + rate)
    account.total[2] += dt * lost


@compiled_strictly
def _is_sound(cells: Cells, blocks: npt.NDArray[np.int64], min_dilatation: float, max_dilatation: float) -> bool:
    """Tell whether `_inspect` would find no element of some blocks at fault, all lanes at once."""
    faults = 0
    for block in range(blocks.shape[0]):
        for e in range(blocks[block, 0], blocks[block, 1] - 1):
            here, there = cells[e], cells[e + 1]
            for j in range(LANES):
                square, along, sum_ = 0.0, 0.0, 0.0
                for i in range(3):
                    side = there.x[i, j] - here.x[i, j]
                    square += side * side
                    along += here.q[6 + i, j] * side
                    sum_ += abs(here.v[i, j]) + abs(there.v[i, j]) + abs(here.w[i, j])
                for i in range(9):
                    sum_ += abs(here.q[i, j])
                dilatation = np.sqrt(square) * here.inv_rest[j]
                # Written so that NaN is none of it.
                bounded = (square + sum_ < np.inf) & (dilatation >= min_dilatation) & (dilatation <= max_dilatation)
                faults += not (bounded & (along > 0.0))
    return faults == 0


@compiled_strictly
def _inspect(
    cells: Cells,
    worms: Worms,
    worm: int,
    sound: bool,
    min_dilatation: float,
    max_dilatation: float,
    joints: Joints,
    lines: Lines | None,
) -> tuple[int, int]:
    """Status code of a worm and its first element or joint at fault, or (0, -1); lines count on from the elements.

    Where all elements are known to be `sound` they are not looked at.
    """
    n_elem, n_joint = worms.cell.shape[1], worms.reach.shape[1]
    for e in range(0 if sound else n_elem):
        first, j = worms.cell[worm, e], worms.lane[worm, e]
        here, there = cells[first], cells[first + 1]
        square, along, sum_ = 0.0, 0.0, 0.0
        for i in range(3):
            side = there.x[i, j] - here.x[i, j]
            square += side * side
            along += here.q[6 + i, j] * side
            sum_ += abs(here.v[i, j]) + abs(there.v[i, j]) + abs(here.w[i, j])
        for i in range(9):
            sum_ += abs(here.q[i, j])
        if not np.isfinite(square + sum_):
            return 1, e
        dilatation = np.sqrt(square) * here.inv_rest[j]
        if dilatation < min_dilatation or dilatation > max_dilatation:
            return 2, e
        if along <= 0.0:
            return 3, e
    for k in range(n_joint):
        n = worm * n_joint + k
        a, b, la, lb = cells[joints.cell_a[n]], cells[joints.cell_b[n]], joints.lane_a[n], joints.lane_b[n]
        square = 0.0
        for i in range(3):
            gap = b.x[i, lb] - a.x[i, la]
            square += gap * gap
        if not square <= worms.reach[worm, k] * worms.reach[worm, k]:
            return 4, k
    if lines is not None:
        n_line = lines.cell_a.shape[0] // worms.row.shape[0]
        for k in range(n_line):
            n = worm * n_line + k
            a, b, la, lb = cells[lines.cell_a[n]], cells[lines.cell_b[n]], lines.lane_a[n], lines.lane_b[n]
            square = 0.0
            for i in range(3):
                side = b.x[i, lb] - a.x[i, la]
                square += side * side
            dilatation = np.sqrt(square) / lines.rest_length[n]
            if dilatation < min_dilatation or dilatation > max_dilatation:
                return 2, n_elem + k
    return 0, -1


@entry
def run(
    cells: Cells,
    work: Cells,
    passive: npt.NDArray[np.int64],
    active: npt.NDArray[np.int64],
    joints: Joints,
    joint_damping: npt.NDArray[np.float64] | None,
    lines: Lines | None,
    hill: Hill | None,
    loads: float | None,
    ground: Ground | None,
    couples: float | None,
    spin_damping: float | None,
    symmetric: float | None,
    ball: Ball | None,
    contact: Contact | None,
    account: Account | None,
    n_steps: int,
    dt: float,
    worms: Worms,
    min_dilatation: float,
    max_dilatation: float,
) -> None:
    """Advance all worms as `advance` does, inspect each and write out where the nodes of the sound ones are."""
    advance(
        cells, work, passive, active, joints, joint_damping, lines, hill, loads, ground, couples, spin_damping,
        symmetric, ball, contact, account, n_steps, dt,
    )  # fmt: skip
    sound = True
    for blocks in (passive, active):
        sound = sound and _is_sound(cells, blocks, min_dilatation, max_dilatation)
    for worm in range(worms.row.shape[0]):
        code, found = _inspect(cells, worms, worm, sound, min_dilatation, max_dilatation, joints, lines)
        worms.status[worm], worms.found[worm] = code, found
        if code == 0:
            row = worms.row[worm]
            for n in range(worms.node_cell.shape[1]):
                here, j = cells[worms.node_cell[worm, n]], worms.node_lane[worm, n]
                for i in range(3):
                    worms.position[row, n, i], worms.velocity[row, n, i] = here.x[i, j], here.v[i, j]
