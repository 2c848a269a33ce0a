"""Trains PPO by its command line, from an id and a file of settings."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from worm import ID, N_STEP

SETTINGS = f"""
{ID}:
  policy: MlpPolicy
  n_envs: 2
  n_timesteps: {4 * N_STEP}
  n_steps: {N_STEP}
  batch_size: {N_STEP}
  normalize: true
"""


def test_a_model_is_trained_and_saved(tmp_path: Path) -> None:
    """The package registers its ids, arguments of the worm come from the command line."""
    settings = tmp_path / "ppo.yml"
    settings.write_text(SETTINGS, encoding="utf-8")
    words = ["-m", "rl_zoo3.train", "--algo", "ppo", "--env", ID, "--gym-packages", "lattice_gym", "--device", "cpu"]
    words += ["--conf-file", str(settings), "--log-folder", str(tmp_path / "logs"), "--eval-freq", "-1"]
    words += ["--env-kwargs", "control:'ring'", "fidelity:'fast'"]
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "logs").rglob(f"{ID}.zip"))
