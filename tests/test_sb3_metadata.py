"""What the adapter for Stable-Baselines3 says of itself is what its worms say."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import gymnasium
import pytest
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecFrameStack, VecVideoRecorder

from lattice_gym.sb3 import WormVecEnv

pytestmark = pytest.mark.slow

WORM: dict[str, Any] = {"id": "LatticeWormExtension-v0", "control": "ring", "fidelity": "fast"}


def _adapter(**others: Any) -> Any:
    return WormVecEnv(gymnasium.make_vec(num_envs=2, autoreset_mode=AutoresetMode.SAME_STEP, **WORM, **others))


@pytest.mark.parametrize("control_dt", [0.05, 0.1])
def test_metadata_and_specification_are_the_worms(control_dt: float) -> None:
    """Frame rate, render modes and id; what is written into the adapter's stays its own."""
    venv = _adapter(control_dt=control_dt, render_mode="rgb_array")
    assert venv.metadata == venv.envs.metadata == venv.get_attr("metadata")[0]
    assert venv.metadata["render_fps"] == 1.0 / control_dt
    assert venv.render_mode == venv.envs.render_mode == "rgb_array"
    assert venv.spec == venv.envs.spec == venv.get_attr("spec")[1]
    venv.metadata["render_fps"] = 7.0
    assert venv.envs.metadata["render_fps"] == 1.0 / control_dt
    venv.close()


def test_a_video_recorder_takes_the_frames_of_the_worm(tmp_path: Path) -> None:
    """20 a second, not the 30 that it takes where nothing is said, also with a wrapper between."""
    worms = _adapter(render_mode="rgb_array")
    for venv in (worms, VecFrameStack(worms, 2)):
        recorder = VecVideoRecorder(venv, str(tmp_path), lambda step: step == 0, 2)
        assert recorder.frames_per_sec == 20.0
    assert recorder.spec.id == WORM["id"]
    recorder.close()


def test_the_adapter_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    """And a command that installs it."""
    monkeypatch.delitem(sys.modules, "lattice_gym.sb3")
    for name in [name for name in sys.modules if name.partition(".")[0] == "stable_baselines3"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(
        ImportError, match=r'^lattice_gym\.sb3 needs .*stable_baselines3.*: pip install "stable-baselines3>='
    ):
        import_module("lattice_gym.sb3")
