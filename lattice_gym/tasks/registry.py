"""Every task by name."""

from __future__ import annotations

from lattice_gym.body.lattice import Lattice
from lattice_gym.physics.assembly import RodModel
from lattice_gym.tasks.base import Given, Task
from lattice_gym.tasks.bending import Bending
from lattice_gym.tasks.compression import Compression
from lattice_gym.tasks.crawl import Crawl
from lattice_gym.tasks.extension import Extension
from lattice_gym.tasks.peristalsis import Peristalsis
from lattice_gym.tasks.reach import Reach
from lattice_gym.tasks.transport import Transport

TASKS: dict[str, type[Task]] = {
    task.name: task for task in (Extension, Compression, Bending, Peristalsis, Reach, Crawl, Transport)
}
"""Every task by name."""


def make_task(
    name: str,
    lattice: Lattice,
    control_dt: float,
    command: Given | None = None,
    model: RodModel | None = None,
    n_worm: int = 1,
) -> Task:
    """Task by name; see Task for the arguments."""
    if not isinstance(name, str) or name not in TASKS:
        raise ValueError(f"task = {name!r}: must be one of {', '.join(TASKS)}")
    return TASKS[name](lattice, control_dt, command, model, n_worm)
