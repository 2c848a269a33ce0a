"""Floating-point operations of a step, counted while the kernels' own source runs on numbers that count.

With numba's compilation switched off the kernels are plain Python: `count_operations` starts such a process, in which
this module catches what the fused engine packs for the benchmark scene on its way into `kernels.advance`, puts counting
numbers into every lane that holds a rod, and takes what two steps need more than one. So the count is that of the
source as it stands, of what the scene has and of no spare lane; the compiler may still save some of it.
"""

from __future__ import annotations

import inspect
import json
import os
import subprocess
import sys
from collections import Counter
from dataclasses import asdict, dataclass
from types import SimpleNamespace
from typing import Any, NoReturn
from unittest.mock import patch

import numpy as np

KINDS = ("add", "multiply", "divide", "root")
"""Additions and subtractions; multiplications, division by a constant among them; divisions; square roots.

A fused multiply-add is one of each of the first two.
"""


@dataclass(frozen=True)
class Work:
    """What a step of the benchmark scene takes."""

    operations: dict[str, int]
    """Floating-point operations by kind, see `KINDS`."""
    elements: int
    lane_elements: int
    """Elements and those of spare lanes."""
    bytes_per_element: float
    """Size of a record over its lanes."""

    @property
    def total(self) -> int:
        """Floating-point operations of all kinds."""
        return sum(self.operations.values())


_done: Counter[str] = Counter()


class Counting:
    """A number that counts what is done with it; signs and comparisons are free."""

    __slots__ = ("value",)

    def __init__(self, value: float) -> None:
        self.value = value

    def __add__(self, other: Any) -> Counting:
        return _result("add", self.value + _value(other))

    def __sub__(self, other: Any) -> Counting:
        return _result("add", self.value - _value(other))

    def __rsub__(self, other: Any) -> Counting:
        return _result("add", _value(other) - self.value)

    def __mul__(self, other: Any) -> Counting:
        return _result("multiply", self.value * _value(other))

    def __truediv__(self, other: Any) -> Counting:
        return _result("divide" if isinstance(other, Counting) else "multiply", self.value / _value(other))

    def __rtruediv__(self, other: Any) -> Counting:
        return _result("divide", _value(other) / self.value)

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self) -> Counting:
        return Counting(-self.value)

    def __lt__(self, other: Any) -> bool:
        return bool(self.value < _value(other))

    def __gt__(self, other: Any) -> bool:
        return bool(self.value > _value(other))

    def sqrt(self) -> Counting:
        """Return its root; numpy calls it."""
        return _result("root", self.value**0.5)


def _fused(a: Any, b: Any, c: Any) -> Any:
    """Count a fused multiply-add as both; it is rounded twice here, which matters not."""
    return a * b + c


def _value(number: Any) -> float:
    return float(number.value if isinstance(number, Counting) else number)


def _result(kind: str, value: float) -> Counting:
    _done[kind] += 1
    return Counting(value)


class Records:
    """Records of the kernels as arrays of objects by field, each of shape (n_cell, ...), with the access they need."""

    def __init__(self, fields: dict[str, Any]) -> None:
        self.fields = fields
        self.shape = (len(next(iter(fields.values()))),)

    def __getitem__(self, key: str | int | slice) -> Any:
        if isinstance(key, str):
            return self.fields[key]
        part = {name: array[key] for name, array in self.fields.items()}
        return Records(part) if isinstance(key, slice) else SimpleNamespace(**part)


class _CaughtError(Exception):
    """Carries what was to go into the kernel."""

    def __init__(self, arguments: dict[str, Any]) -> None:
        super().__init__()
        self.arguments = arguments


def _packed() -> dict[str, Any]:
    """Arguments of `kernels.advance`, by name, as the fused engine packs the benchmark scene."""
    from lattice_gym.benchmarks.engines import BENCHMARK_DT, benchmark_model
    from lattice_gym.engines.fused import kernels
    from lattice_gym.engines.registry import make_engine

    signature = inspect.signature(kernels.advance)

    def catch(*arguments: Any) -> NoReturn:
        raise _CaughtError(dict(signature.bind(*arguments).arguments))

    model = benchmark_model()
    engine = make_engine("fused", model, BENCHMARK_DT)
    with patch.object(kernels, "advance", catch):
        try:
            engine.advance(np.full(model.n_muscle, 0.5), 1)
        except _CaughtError as caught:
            return caught.arguments
    raise RuntimeError("kernels.advance was not called")


def _count() -> Work:
    """Count in this process; only where compilation is off."""
    from lattice_gym.engines.fused import kernels

    arguments = _packed()
    cells, counting = arguments["cells"], np.frompyfunc(Counting, 1, 1)
    fields = {name: cells[name].astype(object) for name in kernels.CELL.names or ()}
    elements = lane_elements = 0
    for first, last in (*arguments["passive"], *arguments["active"]):
        # A force moves a node of every rod, and nothing of a spare lane.
        held = (cells["push"][first:last] > 0.0).any(axis=0)
        for array in fields.values():
            array[first:last, ..., held] = counting(array[first:last, ..., held])
        elements += int(held.sum()) * int(last - first - 1)
        lane_elements += kernels.LANES * int(last - first - 1)
    work = arguments["work"]
    arguments["cells"] = Records(fields)
    arguments["work"] = Records({name: work[name].astype(object) for name in kernels.WORK.names or ()})
    counts = []
    # What the functions return is a float already, as they say for those who read types.
    with patch.object(kernels, "fma", _fused), patch.object(kernels, "float", lambda number: number, create=True):
        for n_steps in (1, 2):
            _done.clear()
            kernels.advance(**arguments | {"n_steps": n_steps})
            counts.append(dict(_done))
    operations = {kind: counts[1].get(kind, 0) - counts[0].get(kind, 0) for kind in KINDS}
    return Work(operations, elements, lane_elements, kernels.CELL.itemsize / kernels.LANES)


def count_operations() -> Work:
    """Count what one step of the benchmark scene takes.

    Raises
    ------
    RuntimeError
        The process that counts failed.
    """
    done = subprocess.run(
        [sys.executable, "-m", "lattice_gym.benchmarks.operations"],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise RuntimeError(f"counting operations failed: {done.stderr[-2000:]}")
    return Work(**json.loads(done.stdout))


if __name__ == "__main__":
    sys.stdout.write(json.dumps(asdict(_count())))
