"""The compiled code itself: no index leaves its array, and it reads nothing from elsewhere."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np

from lattice_gym.engines.fused.engine import FusedEngine
from lattice_gym.engines.fused.kernels import compiling
from lattice_gym.engines.pyelastica.engine import PyElasticaEngine
from lattice_gym.physics.assembly import Clamp, RodModel
from lattice_gym.physics.laws.ball import RigidBall
from lattice_gym.physics.laws.contact import Contact
from lattice_gym.physics.laws.damping import Splitting
from lattice_gym.physics.laws.ground import Ground
from lattice_gym.physics.laws.hill import Hill
from lattice_gym.physics.laws.joints import Joint
from lattice_gym.physics.laws.lines import Line
from lattice_gym.physics.laws.loads import PointForce, PointTorque
from lattice_gym.physics.rod import straight_rod

FOLDER = Path(compiling.__file__).parent
PACKAGE = FOLDER.parents[2]


def all_laws() -> RodModel:
    """Rods with all laws at once; the last lies on the first, and the ball on the second."""
    rod = {
        "radius": 0.05, "density": 1000.0, "youngs_modulus": 1e6, "shear_modulus": 4e5,
        "damping": 0.5, "rotational_damping": 1e-3,
    }  # fmt: skip
    return RodModel(
        rods=(
            straight_rod((0, 0, 0), (0, 0, 1), 3, **rod),
            straight_rod((0, 0, 1), (1, 0, 1), 4, **rod),
            straight_rod((0, 0, 0), (1, 0, 1), 2, **rod),
            straight_rod((0.11, -0.5, 0.3), (0.11, 0.5, 0.3), 4, **rod),
        ),
        joints=(Joint(0, 3, 1, 0, 1e4, 2.0), Joint(2, 0, 0, 0, 1e4), Joint(2, 2, 1, 4, 1e4)),
        clamps=(Clamp(0, node=0, element=0),),
        forces=(PointForce(1, 2, (0.0, 50.0, 10.0)),),
        torques=(PointTorque(0, 1, (0.0, 1.0, 20.0)),),
        muscles=(2,),
        lines=(Line(0, 1, 3, 2, 0.3, 100.0, mass=2.0, damping=0.1),),
        ball=RigidBall(
            position=np.array([0.5, 0.0, 1.149]),
            radius=0.1,
            mass=1.0,
            stiffness=1e3,
            damping=1.0,
            friction=0.5,
            force=(0.0, 0.0, -9.8),
        ),
        gravity=np.array([0.0, 0.0, -9.8]),
        medium_drag=0.3,
        ground=Ground(stiffness=300.0, damping=3.0, forward=0.2),
        hill=Hill(),
        contact=Contact(stiffness=1e3, damping=1.0),
    )


def plain_multiply_add(a: float, b: float, c: float) -> float:
    """Stand in for the compiled one; it is rounded twice."""
    return a * b + c


def run_all_laws() -> None:
    """Let every law act, as in PyElastica; then let elements turn and damp beyond the reach of the series."""
    for name, module in list(sys.modules.items()):
        if name.startswith("lattice_gym.engines.fused.kernels.") and hasattr(module, "fma"):
            vars(module)["fma"] = plain_multiply_add
    model = all_laws()
    state = model.rest_state().copy()
    state.position[model.nodes(3), 0] -= 0.015
    state.velocity[model.nodes(3)] = (-3.0, 0.0, 0.0)
    n_step, dt, ramp = 5, 1e-5, [[[0.0, 0.0]], [[5.0, 1.0]]]
    reference = PyElasticaEngine([model], dt)
    engines = [FusedEngine([model], dt, splitting, energy_check=True) for splitting in get_args(Splitting)]
    for engine in (*engines, reference):
        engine.restore(0, state)
        assert engine.advance(ramp, n_step).tolist() == [0]
    a, b = engines[0].state(), reference.state()
    for field in ("position", "velocity", "directors", "omega", "ball_position", "ball_velocity", "ball_omega"):
        mine, other = getattr(a, field), getattr(b, field)
        assert np.abs(mine - other).max() < 1e-12 * np.abs(other).max(), field
    for engine in engines:
        laws = engine.packs[0].laws
        assert laws.contact is not None
        assert laws.ball is not None
        assert laws.account is not None
        assert laws.contact.n_listed[0] > 0
        assert laws.ball.load[2] > 0.0
        assert (laws.account.ground_reaction != 0.0).any()
        assert (laws.account.total != 0.0).all()
        omega = state.omega.copy()
        omega[model.elements(3)] = (0.6 / dt, 0.0, 0.0)
        engine.restore(0, replace(state, omega=omega))
        engine.advance(ramp, 1)
        assert np.isfinite(engine.state().position).all()
        rods = tuple(replace(rod, rotational_damping=1e6) for rod in model.rods)
        engine.replace(0, replace(model, rods=rods))
        engine.advance(ramp, 1)
        assert np.isfinite(engine.state().position).all()


def test_no_index_leaves_its_array(tmp_path: Path) -> None:
    """Every law, as plain Python, where numpy checks indices: compiled code would not tell."""
    path = [str(PACKAGE.parent), str(Path(__file__).parent)]
    use = f"import sys; sys.path[:0] = {path}; import test_kernels; test_kernels.run_all_laws()"
    done = subprocess.run(
        [sys.executable, "-c", use],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]


def test_kernels_use_nothing_from_elsewhere() -> None:
    """What is compiled may read only this folder, numpy and numba: a change elsewhere would not be noticed."""
    for path in FOLDER.glob("*.py"):
        tree = ast.parse(path.read_text())
        foreign = {
            name.asname or name.name
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and not str(node.module).startswith("lattice_gym.engines.fused.kernels")
            for name in node.names
            if str(node.module).startswith("lattice_gym")
        }
        for function in ast.walk(tree):
            if isinstance(function, ast.FunctionDef) and function.decorator_list:
                read = {node.id for line in function.body for node in ast.walk(line) if isinstance(node, ast.Name)}
                assert not read & foreign, (path.name, function.name)
