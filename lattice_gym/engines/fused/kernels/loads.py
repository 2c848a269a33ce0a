"""Constant loads: the force that every step of a node starts from, and couples on elements."""

from __future__ import annotations

from lattice_gym.checks import FloatArray
from lattice_gym.engines.fused.kernels.layout import Cells, Places
from lattice_gym.engines.fused.kernels.medium import weights
from lattice_gym.physics.assembly import RodModel


def node_loads(model: RodModel) -> FloatArray:
    """Weights and point forces [N], shape (n_node, 3)."""
    load = weights(model)
    for force in model.forces:
        load[int(model.node_offset[force.rod]) + force.node] += force.force
    return load


def fill_forces(cells: Cells, node: Places, model: RodModel) -> None:
    """Write the loads on a worm's nodes, which the first step starts from too."""
    for name in ("load", "force"):
        cells[name][node.cell, :, node.lane] = node_loads(model)


def fill_torques(cells: Cells, element: Places, model: RodModel) -> None:
    """Write the couples on a worm's elements [N m]."""
    cells["couple"][element.cell, :, element.lane] = 0.0
    for load in model.torques:
        e = int(model.element_offset[load.rod]) + load.element
        cells["couple"][element.cell[e], :, element.lane[e]] += load.torque
