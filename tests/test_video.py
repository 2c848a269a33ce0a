"""Films keep simulated time, open in players, and leave nothing when they are interrupted."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pictured import SIZE, green, imageio_ffmpeg
from PIL import Image

from lattice_gym.body.lattice import Lattice
from lattice_gym.physics.assembly import RodModel
from lattice_gym.recording.trajectory import Trajectory
from lattice_gym.rendering import video
from lattice_gym.rendering.scene import Renderer
from lattice_gym.rendering.video import render_video

pytestmark = pytest.mark.slow


@given(
    steps=st.lists(st.floats(0.01, 0.5), min_size=1, max_size=20),
    start=st.floats(-10, 10),
    fps=st.one_of(st.none(), st.floats(5, 60)),
    speed=st.floats(0.2, 5),
)
@settings(max_examples=200, deadline=None)
def test_video_time_is_simulated_time(steps: list[float], start: float, fps: float | None, speed: float) -> None:
    """Picture k shows the last frame recorded by time k speed / rate, and none is left after the end."""
    time = np.asarray(start + np.cumsum([0.0, *steps]), dtype=np.float64)
    shown, rate = video.schedule(time, fps, speed)
    at = start + np.arange(len(shown)) * speed / rate
    slack = 1e-5 * speed / rate
    assert np.all(time[shown] <= at + slack)
    assert np.all(at[shown < len(time) - 1] < time[shown[shown < len(time) - 1] + 1] + slack)
    assert time[-1] - speed / rate - slack < at[-1] <= time[-1] + slack
    if fps is None:
        assert 10.0 - 1e-9 <= rate <= 60.0 + 1e-9


@pytest.mark.parametrize(
    ("step", "speed", "rate"), [(0.05, 1.0, 20.0), (0.05, 0.1, 10.0), (0.02, 1.0, 50.0), (1.0 / 60.0, 1.0, 60.0)]
)
def test_default_rate_shows_every_frame_equally_long(step: float, speed: float, rate: float) -> None:
    """No judder where the recording is even."""
    shown, got = video.schedule(np.linspace(0.0, 40 * step, 41), None, speed)
    assert got == pytest.approx(rate)
    assert set(np.bincount(shown)[:-1]) == {round(rate * step / speed)}


def test_fast_recordings_are_thinned() -> None:
    """100 frames a second make 50 pictures a second."""
    shown, rate = video.schedule(np.linspace(0.0, 1.0, 101), None, 1.0)
    assert rate == pytest.approx(50.0)
    assert set(np.diff(shown)) == {2}


def decode(path: Path) -> tuple[str, npt.NDArray[np.uint8]]:
    """Return what ffmpeg says about a video of SIZE, and its pictures."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    ran = subprocess.run(command, capture_output=True, check=True)
    return ran.stderr.decode(), np.frombuffer(ran.stdout, np.uint8).reshape(-1, SIZE[1], SIZE[0], 3)


def test_video(trajectory: Trajectory, coarse_lattice: Lattice, coarse_model: RodModel, tmp_path: Path) -> None:
    """It plays everywhere, in real time, and shows the frames in order."""
    calls: list[tuple[int, int]] = []
    path = tmp_path / "worm.mp4"
    render_video(trajectory, path, size=SIZE, progress=lambda done, total: calls.append((done, total)))
    facts, pictures = decode(path)
    assert all(fact in facts for fact in ("Video: h264", "yuv420p", "160x120", "10 fps", "Duration: 00:00:00.70"))
    assert calls == [(k + 1, 7) for k in range(7)]
    with Renderer(coarse_lattice, coarse_model, SIZE, view=trajectory.position.reshape(-1, 3)) as renderer:
        for k in (0, 6):
            expected = renderer.update(
                trajectory.position[k], trajectory.activation[k], trajectory.time[k], trajectory.outcome[k]
            )
            assert np.abs(pictures[k].astype(float) - expected).mean() < 6.0
            assert np.abs(pictures[k].astype(float) - pictures[3]).mean() > 6.0
    assert [p.name for p in tmp_path.iterdir()] == ["worm.mp4"]


@pytest.mark.parametrize("name", ["worm.mp4", "worm.gif"])
def test_a_film_marks_what_was_asked_for(trajectory: Trajectory, tmp_path: Path, name: str) -> None:
    """In every picture, wherever it lies: the view takes it in."""
    far = replace(trajectory, markers=np.array([[0.0, 0.0, 0.25]], np.float32))
    render_video(far, tmp_path / name, size=SIZE)
    _, pictures = decode(tmp_path / name)
    assert len(pictures) == 7
    assert all(green(picture).sum() > 4 for picture in pictures)


def test_slow_motion(trajectory: Trajectory, tmp_path: Path) -> None:
    """At half speed a second lasts two."""
    render_video(trajectory, tmp_path / "slow.mp4", fps=20.0, speed=0.5, size=(64, 64))
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "slow.mp4"))
    assert count == 25
    assert seconds == pytest.approx(1.25)


def test_gif(trajectory: Trajectory, tmp_path: Path) -> None:
    """The suffix chooses an animated GIF: the same pictures at the same times, for ever."""
    path = tmp_path / "worm.gif"
    render_video(trajectory, path, size=SIZE)
    render_video(trajectory, tmp_path / "worm.mp4", size=SIZE)
    _, pictures = decode(tmp_path / "worm.mp4")
    with Image.open(path) as animation:
        assert (getattr(animation, "n_frames", 1), animation.info["loop"], animation.info["duration"]) == (7, 0, 100)
        for k in (0, 6):
            animation.seek(k)
            assert np.abs(np.asarray(animation.convert("RGB"), float) - pictures[k]).mean() < 8.0


@pytest.mark.parametrize("rate", [20.0, 30.0, 12.5, 50.0])
def test_gif_keeps_time(trajectory: Trajectory, tmp_path: Path, rate: float) -> None:
    """Whole hundredths of a second a picture, of which none is lost in the sum, nor by any picture."""
    path = tmp_path / "worm.gif"
    render_video(trajectory, path, fps=rate, size=(64, 64))
    count = len(video.schedule(trajectory.time, rate, 1.0)[0])
    total = 0.0
    with Image.open(path) as animation:
        for k in range(getattr(animation, "n_frames", 1)):
            animation.seek(k)
            total += animation.info["duration"]
    assert abs(total - 1000.0 * count / rate) <= 5.0
    ends = np.cumsum(video.gif_durations(1000, rate))
    assert np.abs(ends - 1000.0 / rate * np.arange(1, 1001)).max() <= 5.0 + 1e-6
    assert min(video.gif_durations(1000, rate)) >= 20


def test_gifs_have_a_fastest_rate(trajectory: Trajectory, tmp_path: Path) -> None:
    """Asked for, a faster one is refused; by default pictures are left out."""
    with pytest.raises(ValueError, match=r"^fps = 60\.0: must be a number from 1 to 50 \[pictures/s\]"):
        render_video(trajectory, tmp_path / "worm.gif", fps=60.0)
    assert not list(tmp_path.iterdir())
    time = np.linspace(0.0, 1.0, 61)
    assert video.schedule(time, None, 1.0, video.FASTEST_GIF)[1] == pytest.approx(30.0)


def stop(done: int, total: int) -> None:
    """End a video half-way."""
    if done > total // 2:
        raise KeyboardInterrupt


def test_interrupted_video_leaves_nothing(trajectory: Trajectory, tmp_path: Path) -> None:
    """Neither a half video nor a temporary file."""
    with pytest.raises(KeyboardInterrupt):
        render_video(trajectory, tmp_path / "worm.mp4", size=(64, 64), progress=stop)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "name"),
    [({"size": (161, 120)}, "size"), ({"speed": 0.0}, "speed"), ({"speed": np.nan}, "speed"), ({"fps": 0.5}, "fps")],
)
def test_wrong_video_arguments_are_refused(
    trajectory: Trajectory, tmp_path: Path, arguments: dict[str, Any], name: str
) -> None:
    """Before anything is written."""
    with pytest.raises(ValueError, match=name):
        render_video(trajectory, tmp_path / "worm.mp4", **arguments)
    assert not list(tmp_path.iterdir())
