"""Build the wheel and the source distribution, install each into an empty environment, and make it step there.

    python .ci/package.py [--out FOLDER] [--draw]

With CPython 3.11 or newer and pip, on any system; what it needs beside, it installs into environments that it removes.
`--draw` installs the extra "video" too and draws a picture.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STEP = """
import gymnasium
env = gymnasium.make("lattice_gym:LatticeWorm-v0", control="ring", render_mode="rgb_array" if {draw} else None)
env.reset(seed=0)
for _ in range(3):
    observation, reward, terminated, *_ = env.step(env.action_space.sample())
assert observation in env.observation_space and not terminated
many = gymnasium.make_vec("lattice_gym:LatticeWormCrawl-v0", num_envs=2, fidelity="fast")
many.reset(seed=0)
many.step(many.action_space.sample())
if {draw}:
    assert env.render().shape == (480, 640, 3)
import lattice_gym
print(lattice_gym.__file__)
"""
FORBIDDEN = ("agents/", "tests/", "lattice_gym/benchmarks/")
"""What a wheel must not hold."""


def main() -> None:
    """Build, look, install, step."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="where both are left; by default nowhere")
    parser.add_argument("--draw", action="store_true", help='install the extra "video", and draw')
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        built = folder / "dist" if options.out is None else options.out.resolve()
        tools = environment(folder / "tools", "build", "twine")
        run(tools, "-m", "build", "--outdir", str(built), str(ROOT), cwd=folder)
        found = [*built.glob("lattice_gym-*.whl"), *built.glob("lattice_gym-*.tar.gz")]
        if len(found) != 2:
            sys.exit(f"error: {built} holds {[path.name for path in found]}: must hold one wheel and one .tar.gz")
        run(tools, "-m", "twine", "check", "--strict", *map(str, found), cwd=folder)
        look_into(found[0])
        for number, path in enumerate(found):
            python = environment(folder / f"empty{number}", f"{path}[video]" if options.draw else str(path))
            place = run(python, "-c", STEP.format(draw=options.draw), cwd=folder).strip()
            if not Path(place).resolve().is_relative_to(folder.resolve()):
                sys.exit(f"error: {place} was imported, not what was installed")
            print(f"{path.name}: installed, stepped{' and drew' if options.draw else ''}", flush=True)


def look_into(wheel: Path) -> None:
    """End with an error unless a wheel holds what it must and nothing else."""
    names = zipfile.ZipFile(wheel).namelist()
    wrong = [name for name in names if name.startswith(FORBIDDEN)]
    top = {name.split("/")[0] for name in names if ".dist-info/" not in name}
    if wrong or top != {"lattice_gym"} or "lattice_gym/py.typed" not in names:
        sys.exit(f"error: {wheel.name} holds {sorted(top)} and {wrong[:3]}, or no lattice_gym/py.typed")
    if not any(name.endswith("/LICENSE") for name in names):
        sys.exit(f"error: {wheel.name} holds no licence")


def environment(folder: Path, *requirements: str) -> Path:
    """Python of a new environment with these installed, and nothing else but pip."""
    venv.create(folder, with_pip=True)
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    run(python, "-m", "pip", "install", "--quiet", *requirements, cwd=folder)
    return python


def run(python: Path, *words: str, cwd: Path) -> str:
    """Call Python away from the clone and with none of its settings; what it prints, or an error that ends this."""
    settings = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run([str(python), *words], cwd=cwd, env=settings, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"error: {' '.join(words)[:200]} ended with {done.returncode}\n{done.stdout}")
    return done.stdout


if __name__ == "__main__":
    main()
