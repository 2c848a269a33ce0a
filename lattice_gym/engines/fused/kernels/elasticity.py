"""Linear elasticity of a Cosserat rod of circular section: Gazzola et al. 2018, R. Soc. Open Sci. 5:171628.

Discretised as PyElastica 1.0.0 does it. Directors are the rows of Q, t is the unit tangent, e the dilatation of an
element, and it keeps its volume.
"""

from __future__ import annotations

from lattice_gym.checks import FloatArray
from lattice_gym.engines.fused.kernels.arithmetic import fma
from lattice_gym.engines.fused.kernels.compiling import inlined
from lattice_gym.engines.fused.kernels.layout import Cells
from lattice_gym.physics.rod import Rod


def fill(cells: Cells, lane: int, rod: Rod, dt: float) -> None:
    """Write a rod's constants and rest shape into one lane of its records, shape (n_elem + 1,)."""
    elements, voronoi = cells[:-1], cells[:-2]
    cells["x"][:, :, lane] = rod.position
    elements["q"][:, :, lane] = rod.directors.reshape(-1, 9)
    elements["rest"][:, lane] = rod.rest_length
    elements["inv_rest"][:, lane] = 1.0 / rod.rest_length
    elements["shear"][:, lane] = rod.shear_stiffness
    elements["stretch"][:, lane] = rod.stretch_stiffness
    elements["spin_kick"][:, lane] = dt / rod.inertia / rod.rest_length
    # Together with the cube of twice the rest length, by which the kernel's sum of lengths is to be divided.
    voronoi["bend"][:, lane] = 16.0 * rod.bend_stiffness * rod.rest_voronoi**2
    voronoi["twist"][:, lane] = 16.0 * rod.twist_stiffness * rod.rest_voronoi**2
    voronoi["rest_turn"][:, :, lane] = 0.5 * rod.rest_kappa * rod.rest_voronoi[:, None]


@inlined
def force_along_d3(along: float, inverse: float, rest: float, shear: float, stretch: float) -> float:
    """Part of the force of shear and stretch along d3, for `along` = d3 . (e t) rest and `inverse` = 1 / (e rest).

    With S, B the stiffness against shear and stretch the force is Q^T diag(S, S, B) (e Q t - d3) / e =
    S t + [B (e d3.t - 1) - S e d3.t] / e d3, as both directions of shear are alike (equations 2.13, 3.3).
    """
    return float(fma(stretch, along - rest, -(shear * along)) * inverse)


@inlined
def bend_and_twist(
    u: tuple[float, float, float], rest_turn: FloatArray, j: int, lengths: float, bend: float, twist: float
) -> tuple[float, float, float, float, float, float]:
    """Couples of bend and twist on elements e and e + 1 [N m], in the material frame.

    With 2 u the rotation vector between both elements, t = 2 B (u - u_rest) / (rest e^3), e the dilatation of the
    Voronoi region, the couple on element e is u x t + t, on e + 1 u x t - t. `lengths` is the sum of both.
    """
    u0, u1, u2 = u
    cube = 1.0 / (lengths * lengths * lengths)
    across, around = bend * cube, twist * cube
    t0, t1, t2 = (
        across * (u0 - rest_turn[0, j]),
        across * (u1 - rest_turn[1, j]),
        around * (u2 - rest_turn[2, j]),
    )
    z0, z1, z2 = fma(u1, t2, -(u2 * t1)), fma(u2, t0, -(u0 * t2)), fma(u0, t1, -(u1 * t0))
    return z0 + t0, z1 + t1, z2 + t2, z0 - t0, z1 - t1, z2 - t2
