"""The compiled code itself: no index leaves its array, and no edit runs stale machine code."""

from __future__ import annotations

import ast
import os
import shutil
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
        scene = engine.packs[0].scene
        assert scene.contact is not None
        assert scene.ball is not None
        assert scene.account is not None
        assert scene.contact.n_listed[0] > 0
        assert scene.ball.load[2] > 0.0
        assert (scene.account.ground_reaction != 0.0).any()
        assert (scene.account.total != 0.0).all()
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
    python(use, tmp_path, {"NUMBA_DISABLE_JIT": "1"})


def python(code: str, folder: Path, environment: dict[str, str]) -> str:
    """Run code in a process and a folder of its own; return what it printed."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | environment,
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


_USE = """
from lattice_gym.engines.fused.kernels.elasticity import force_along_d3
print(force_along_d3(2.0, 1.0, 0.0, 1.0, 2.0), len(force_along_d3.stats.cache_hits))
"""


def test_no_edit_runs_stale_machine_code(tmp_path: Path) -> None:
    """What is compiled of one file is kept, and is compiled anew when a helper in another file was edited."""
    shutil.copytree(PACKAGE, tmp_path / PACKAGE.name, ignore=shutil.ignore_patterns("__pycache__", "benchmarks"))
    folder = tmp_path / FOLDER.relative_to(PACKAGE.parent)
    helper = folder / "arithmetic.py"
    assert [python(_USE, tmp_path, {"NUMBA_CACHE_DIR": ""}) for _ in range(2)] == ["2.0 0\n", "2.0 1\n"]
    helper.write_text(helper.read_text().replace("builder.fma(*values)", "builder.fneg(builder.fma(*values))"))
    assert python(_USE, tmp_path, {"NUMBA_CACHE_DIR": ""}) == "-2.0 0\n"
    # What was kept of the version before is gone, and what numba is told of places holds.
    assert len(list((folder / "__pycache__").glob("elasticity.force_along_d3*.nbi"))) == 1
    assert python(_USE, tmp_path, {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}) == "-2.0 0\n"
    assert len(list((tmp_path / "kept").rglob("elasticity.force_along_d3*.nbi"))) == 1


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


def test_other_code_keeps_its_own_cache(tmp_path: Path) -> None:
    """The rule of this folder is not that of the process, even while its modules are being imported."""
    (tmp_path / "foreign.py").write_text("def double(x):\n    return 2.0 * x\n")
    use = """
import threading
from numba import njit
from numba.core import config
import foreign
done = threading.Event()
def loop():
    while not done.is_set():
        njit(cache=True)(foreign.double)(1.0)
thread = threading.Thread(target=loop)
thread.start()
import lattice_gym.engines.fused.kernels.step
done.set()
thread.join()
print(len(njit(cache=True)(foreign.double).stats.cache_path) > 0, config.CACHE_LOCATOR_CLASSES)
"""
    environment = {"PYTHONPATH": os.pathsep.join([str(PACKAGE.parent), str(tmp_path)]), "NUMBA_CACHE_DIR": ""}
    assert python(use, tmp_path, environment).split(maxsplit=1)[0] == "True"
    assert len(list((tmp_path / "__pycache__").glob("foreign.double*.nbc"))) == 1
