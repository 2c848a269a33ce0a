"""Small training runs that several files of tests use."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from agents.config import TrainConfig

TINY = TrainConfig(
    task="extension", total_steps=160, seed=3, n_envs=1, n_steps=80, batch_size=40, n_epochs=2, checkpoint_every=80
)


DAMAGE: dict[str, Callable[[Path], object]] = {
    "missing": Path.unlink,
    "empty": lambda file: file.write_bytes(b""),
    "truncated": lambda file: file.write_bytes(file.read_bytes()[: file.stat().st_size // 2]),
    "foreign": lambda file: file.write_bytes(bytes(range(256)) * 8),
    "list": lambda file: file.write_text("[1, 2]"),
}
