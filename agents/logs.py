"""The numbers of training, an update after another: progress.csv, and the same for TensorBoard."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import KVWriter, filter_excluded_keys
from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from agents import run_folder


class ProgressTable(KVWriter):
    """progress.csv, whole on the disk at any time; continues from the rows given."""

    def __init__(self, path: Path, rows: list[dict[str, float]]) -> None:
        self._path = path
        self._rows = rows

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Add one row; `step` is in it as time/total_timesteps."""
        values = filter_excluded_keys(key_values, key_excluded, "csv")
        self._rows.append({name: float(value) for name, value in values.items()} | {run_folder.STEPS: step})
        run_folder.write_rows(self._path, self._rows)

    def close(self) -> None:
        """Nothing is open between two rows."""


class Board(KVWriter):
    """A file of events in a folder for TensorBoard, which passes over a record that a killed process left half written.

    TensorBoard's own writer takes only paths in UTF-8, and writes in a thread of which a full disk ends in a traceback.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / f"events.out.tfevents.{time.time_ns()}.{os.getpid()}"
        self._append(Event(wall_time=time.time(), file_version="brain.Event:2"))

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Add the numbers of one update."""
        values = filter_excluded_keys(key_values, key_excluded, "tensorboard")
        scalars = [Summary.Value(tag=name, simple_value=float(value)) for name, value in values.items()]
        self._append(Event(wall_time=time.time(), step=step, summary=Summary(value=scalars)))

    def _append(self, event: Event) -> None:
        with self._path.open("ab") as file:
            RecordWriter(file).write(event.SerializeToString())

    def close(self) -> None:
        """Nothing is open between two updates."""
