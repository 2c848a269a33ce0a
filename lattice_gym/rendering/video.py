"""Videos of recorded trajectories."""

from __future__ import annotations

import errno
import io
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lattice_gym.body.lattice import build_lattice
from lattice_gym.checks import FloatArray, IntArray, invalid_value, number
from lattice_gym.physics.worm import build_model
from lattice_gym.recording.files import checked_path, replacing
from lattice_gym.recording.trajectory import Trajectory
from lattice_gym.rendering.extras import extra
from lattice_gym.rendering.scene import Renderer

FASTEST, FASTEST_GIF = 60.0, 50.0
"""Most pictures a second of a video by default; and of a GIF at all, as viewers slow down what is faster."""
Picture = npt.NDArray[np.uint8]


def render_video(
    trajectory: Trajectory,
    path: str | os.PathLike[str],
    fps: float | None = None,
    speed: float = 1.0,
    progress: Callable[[int, int], None] | None = None,
    size: tuple[int, int] = (960, 720),
) -> None:
    """Write a video in which speed seconds of simulated time pass in one second.

    A path that ends in .gif gives an animated GIF, any other an mp4 (H.264, yuv420p).

    Each picture shows the frame last recorded by then. The default rate shows every frame once, where that makes 10 to
    60 pictures a second (50 in a GIF, whose viewers slow down what is faster). A GIF counts time in hundredths of a
    second, so its pictures last a hundredth more or less where the rate asks for parts of one. Width and height must be
    even. ``progress`` is called with the numbers of pictures done and of all. The file appears under its name only once
    it is complete; an OSError names it where it cannot be written.
    """
    speed = number("speed", speed, 1e-3, 1e3)
    if size[0] % 2 or size[1] % 2:
        raise invalid_value("size", size, "must be even, as the video's pixels share their colour in blocks of 2 x 2")
    animated = checked_path("path", path).suffix.lower() == ".gif"
    if fps is not None:
        fps = number("fps", fps, 1.0, FASTEST_GIF if animated else 240.0, "pictures/s")
    shown, rate = schedule(trajectory.time, fps, speed, FASTEST_GIF if animated else FASTEST)
    lattice = build_lattice(trajectory.design)
    model, ball = build_model(lattice, trajectory.layout, trajectory.world), trajectory.ball
    marked = np.empty((0, 3)) if trajectory.markers is None else trajectory.markers
    view = np.concatenate([trajectory.position.reshape(-1, 3), marked])
    if model.ball is not None and ball is not None:
        centre, radius = ball.reshape(-1, 3), model.ball.radius
        view = np.concatenate([view, centre - radius, centre + radius])
    note = "" if speed == 1.0 else f"   [{speed:g} x real time]"
    sink = _gif if animated else _mp4
    with (
        Renderer(lattice, model, size, view=view, n_marker=len(marked)) as renderer,
        replacing(path) as temporary,
        sink(temporary, size, rate) as write,
    ):
        last = -1
        for k, frame in enumerate(shown.tolist()):
            if frame != last:
                text = trajectory.outcome[frame] + note
                picture = renderer.update(
                    trajectory.position[frame],
                    trajectory.activation[frame],
                    trajectory.time[frame],
                    text,
                    None if ball is None else ball[frame],
                    marked,
                )
                last = frame
            write(picture)
            if progress:
                progress(k + 1, len(shown))


@contextmanager
def _mp4(path: Path, size: tuple[int, int], rate: float) -> Iterator[Callable[[Picture], object]]:
    options: dict[str, Any] = {
        "fps": rate,
        "codec": "libx264",
        "pix_fmt_out": "yuv420p",
        "macro_block_size": 2,
        "ffmpeg_log_level": "fatal",
        "quality": 7,
        "output_params": ["-movflags", "+faststart", "-f", "mp4"],
    }
    ffmpeg = extra("imageio_ffmpeg")
    # It takes "a:b.mp4" for a protocol and "-b.mp4" for an option, but no absolute path for either.
    place = str(path.absolute())
    writer = ffmpeg.write_frames(place, size, **options)
    writer.send(None)
    sent = 0

    def write(picture: Picture) -> None:
        nonlocal sent
        try:
            writer.send(picture)
        except OSError as error:
            raise _why_ffmpeg_ended(path, sent) from error
        sent += 1

    try:
        yield write
    finally:
        writer.close()
    # Where ffmpeg ends at the last pictures the writer does not say so.
    try:
        written, _ = ffmpeg.count_frames_and_secs(place)
    except Exception as error:  # of whatever kind reading half a file gives
        raise _why_ffmpeg_ended(path, sent) from error
    if written != sent:
        raise _why_ffmpeg_ended(path, written)


def _why_ffmpeg_ended(path: Path, written: int) -> OSError:
    """Return the error to raise where ffmpeg ended early: what writing to its file gives, as on a full disk."""
    try:
        with path.open("ab") as file:
            file.write(bytes(1 << 20))
    except OSError as error:
        return error
    return OSError(errno.EIO, f"ffmpeg ended after {written} pictures", str(path))


@contextmanager
def _gif(path: Path, size: tuple[int, int], rate: float) -> Iterator[Callable[[Picture], object]]:
    """Hold the pictures until the last: all share one palette, which keeps colours still and the file small.

    An octree leaves a colour of few pixels, as a marker's, what it is; the median cut mixes it with others.
    """
    image = extra("PIL.Image")
    pictures: list[Picture] = []
    yield pictures.append
    frames = [image.fromarray(picture) for picture in pictures]
    some = image.fromarray(np.concatenate(pictures[:: max(1, len(pictures) // 4)]))
    palette = some.quantize(96, image.Quantize.FASTOCTREE)
    few = [frame.quantize(palette=palette, dither=0) for frame in frames]
    durations = gif_durations(len(few), rate)
    content = io.BytesIO()
    few[0].save(content, format="GIF", save_all=True, append_images=few[1:], duration=durations, loop=0)
    path.write_bytes(content.getvalue())


def gif_durations(count: int, rate: float) -> list[int]:
    """How long each picture of a GIF lasts [ms]: whole hundredths of a second, of which none is lost on the way."""
    ends = np.rint(100.0 / rate * np.arange(count + 1)).astype(np.int64)
    durations: list[int] = (10 * np.diff(ends)).tolist()
    return durations


def schedule(time: FloatArray, fps: float | None, speed: float, fastest: float = FASTEST) -> tuple[IntArray, float]:
    """Which frame each picture of a video shows, and the pictures a second; see `render_video`."""
    if fps is None:
        rate = speed / float(np.median(np.diff(time))) if len(time) > 1 else 10.0
        if rate > fastest:
            rate /= math.ceil(rate / fastest - 1e-6)
        elif rate < 10.0:
            rate *= math.ceil(10.0 / rate - 1e-6)
    else:
        rate = fps
    # A millionth of a picture keeps rounding from showing a frame one picture late.
    count = math.floor((time[-1] - time[0]) / speed * rate + 1e-6) + 1
    at = time[0] + (np.arange(count) + 1e-6) * speed / rate
    return np.searchsorted(time, at, side="right") - 1, rate
