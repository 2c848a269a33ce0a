"""A medium under gravity: weight less buoyancy is a constant load, and drag adds to the damping of nodes."""

from __future__ import annotations

from lattice_gym.checks import FloatArray
from lattice_gym.physics.assembly import RodModel


def weights(model: RodModel) -> FloatArray:
    """Weight of every node less its buoyancy [N], shape (n_node, 3). The drag is part of `RodModel.node_damping`."""
    return model.node_weight.copy()
