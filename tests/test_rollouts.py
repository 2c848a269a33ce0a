"""Rollouts: recorded episodes, pictures and films of them."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest
from runs import DAMAGE, TINY

from agents.config import InputError
from agents.evaluation import POLICIES, evaluate
from agents.rollouts import evaluated_returns, export, record
from agents.run_folder import Run
from agents.training import resume_settings, train
from lattice_gym.body.design import LatticeDesign
from lattice_gym.recording.trajectory import Trajectory
from lattice_gym.rendering.extras import extra

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("damage", DAMAGE)
def test_rollout_names_a_damaged_progress_table(copy: Path, damage: str) -> None:
    """The learning curve needs a sound table."""
    DAMAGE[damage](copy / "progress.csv")
    with pytest.raises(InputError, match=rf"^{re.escape(str(copy / 'progress.csv'))}: (no such file|damaged)"):
        export(copy)


def test_rollout_names_a_damaged_evaluation(copy: Path) -> None:
    """Lines of baselines need a sound report."""
    (copy / "evaluation.json").write_text('{"policies": {}}')
    with pytest.raises(InputError, match=r"evaluation\.json: damaged"):
        export(copy)


def test_learning_curve_shows_no_score_of_an_older_model(copy: Path) -> None:
    """A score belongs to the checkpoint that earned it; baselines stay."""
    evaluate(copy, episodes=1)
    assert set(evaluated_returns(Run.open(copy))) == set(POLICIES.values())
    train(replace(resume_settings(copy), total_steps=240))
    assert set(evaluated_returns(Run.open(copy))) == set(POLICIES.values()) - {"trained policy"}


def test_recorded_episode(finished: Path) -> None:
    """Frames run from the start at rest to the end of the last step."""
    trajectory = record(Run.open(finished), "gait", seed=2)
    assert trajectory.n_frame == 41
    assert trajectory.time[0] == 0.0
    assert trajectory.time[-1] == pytest.approx(2.0)
    assert trajectory.reward[0] == 0.0
    assert trajectory.task == "extension"
    assert np.all(trajectory.activation[0] == 0.0)
    assert np.all(trajectory.activation[-1] > 0.99)
    rise = trajectory.position[-1, :492, 2].max() - trajectory.position[0, :492, 2].max()
    assert rise == pytest.approx(0.031, abs=0.002)
    assert trajectory.outcome[-1] == f"return {trajectory.reward.sum():.2f}   strain {100.0 * rise / 0.1:+.1f} %"


def test_diverged_episode_is_recorded_to_its_end(tmp_path: Path) -> None:
    """The last frame says what went wrong."""
    (tmp_path / "design.json").write_text(LatticeDesign(max_tension=50.0).to_json())
    run = Run.open(train(replace(TINY, design=tmp_path / "design.json", total_steps=80, run_dir=tmp_path / "run")))
    trajectory = record(run, "gait", seed=2)
    assert trajectory.n_frame < 41
    assert trajectory.reward[-1] < -100.0
    line = r"return -\d+\.\d\d   strain \S+ %   \w+: muscle \d+ \(horizontal, level \d at .*, element \d of 2"
    assert re.fullmatch(line, trajectory.outcome[-1])
    assert all("muscle" not in line for line in trajectory.outcome[:-1])


def test_rollout_artefacts_open(copy: Path) -> None:
    """Every file can be read and shows something."""
    evaluate(copy, episodes=1)
    files = export(copy, "policy", seed=11, gif=(0.3, 0.6))
    trajectory = Trajectory.load(files.trajectory)
    ffmpeg = extra("imageio_ffmpeg").get_ffmpeg_exe()
    command = [ffmpeg, "-i", str(files.video), "-f", "rawvideo", "-pix_fmt", "gray", "-"]
    pixels = np.frombuffer(subprocess.run(command, capture_output=True, check=True).stdout, dtype=np.uint8)
    frames = pixels.reshape(trajectory.n_frame, -1).astype(np.float64)
    assert np.abs(frames[-1] - frames[0]).max() > 100.0
    assert files.learning_curve is not None
    for picture in (files.activation, files.learning_curve):
        assert iio.imread(picture).std() > 5.0
    assert files.gif == copy / "policy-11.gif"
    assert iio.imread(files.gif, index=None).shape == (7, 360, 480, 3)


@pytest.mark.parametrize("span", [(0.6, 0.3), (-1.0, 1.0), (1.0, 2.5), (np.nan, 1.0), (0.01, 0.02)])
def test_gif_of_no_part_of_the_episode_is_refused(copy: Path, span: tuple[float, float]) -> None:
    """The error names the span and the episode's."""
    with pytest.raises(InputError, match=r"^gif = \(.*\): must be .* 0 to 2 s"):
        export(copy, "gait", gif=span)


@pytest.mark.parametrize(("policy", "seed", "message"), [("swim", 1, "policy = 'swim'"), ("gait", -1, "seed = -1")])
def test_rollout_refuses_bad_input(finished: Path, policy: Any, seed: int, message: str) -> None:
    """Errors name the argument."""
    with pytest.raises(InputError, match=message):
        record(Run.open(finished), policy, seed)
