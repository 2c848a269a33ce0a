"""Scenes that several files of tests on engines use."""

from __future__ import annotations

import numpy as np

from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.laws.lines import Line
from lattice_gym.physics.laws.loads import PointForce, PointTorque
from lattice_gym.physics.rod import straight_rod

FIELDS = ("position", "velocity", "directors", "omega")


def mixed_assembly() -> RodModel:
    """Rods of four element counts with a muscle among them, joints with dashpots, clamps, a force and a torque.

    A ground bears some of their nodes, those of a clamp among them, and a line hangs between two rods under gravity.
    """
    steel = {"radius": 0.05, "density": 1000.0, "youngs_modulus": 1e6, "shear_modulus": 4e5, "damping": 0.5}
    return RodModel(
        rods=(
            straight_rod((0, 0, 0), (0, 0, 1), 7, **steel),
            straight_rod((0, 0, 1), (1, 0, 1), 4, **steel, rotational_damping=1e-3),
            straight_rod((0, 0, 0), (1, 0, 1), 2, **steel),
            straight_rod((1, 0, 1), (1, 1, 2), 4, **steel),
        ),
        joints=(Joint(0, 7, 1, 0, 1e4, 2.0), Joint(2, 0, 0, 0, 1e4), Joint(2, 2, 1, 4, 1e4), Joint(1, 4, 3, 0, 1e4)),
        clamps=(Clamp(0, node=0, element=0), Clamp(3, node=4)),
        forces=(PointForce(1, 2, (0.0, 50.0, 10.0)), PointForce(1, 2, (1.0, 0.0, 0.0))),
        torques=(PointTorque(0, 6, (0.0, 1.0, 20.0)),),
        muscles=(2,),
        lines=(Line(0, 3, 3, 2, 1.5, 100.0, mass=2.0, damping=0.1, density=900.0),),
        gravity=np.array([1.0, 2.0, -9.0]),
        medium_density=300.0,
        medium_drag=0.3,
        ground=Ground(stiffness=300.0, damping=3.0, forward=0.2),
    )
