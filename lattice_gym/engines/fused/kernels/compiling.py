"""How kernels are compiled.

Code of every file of this folder may be compiled into any kernel: machine code is kept until one of them changes, see
`machine_code`.
"""

from __future__ import annotations

import gc
import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numba.core.compiler_lock import global_compiler_lock

from lattice_gym.engines.fused.machine_code import MachineCode

Function = TypeVar("Function", bound=Callable[..., Any])


@cache
def _version() -> str:
    """Hash of every source file of this folder, as they stood when the first kernel was defined, and numpy's version.

    Coefficients of series are made by numpy and compiled in.
    """
    folder, digest = resources.files(__package__), hashlib.sha256(np.__version__.encode())
    for name in sorted(file.name for file in folder.iterdir() if file.name.endswith(".py")):
        source = folder.joinpath(name).read_bytes()
        digest.update(f"{name} {len(source)} ".encode() + source)
    return digest.hexdigest()[:16]


def _compile(function: Function, **options: Any) -> Function:
    """Compile when first called, and keep the machine code."""
    made: Any = njit(error_model="numpy", **options)(function)
    if made is not function:  # as it is with NUMBA_DISABLE_JIT
        made._cache = MachineCode(function, _version())
    return cast(Function, made)


def compiled(function: Function) -> Function:
    """Compile with no licence but to forget the sign of a zero: NaN must show, and nothing be reordered or fused.

    What the compiler unrolls it would order and fuse differently from one half of the lanes to the other, and how a rod
    moves would depend on its lane: products that are to be fused say so, see `arithmetic.fma`.
    """
    return _compile(function, fastmath={"nsz"})


def inlined(function: Function) -> Function:
    """Compile as `compiled` into whatever calls it: an array takes more instructions to pass than a lane to compute."""
    return _compile(function, fastmath={"nsz"}, forceinline=True)


def compiled_strictly(function: Function) -> Function:
    """Compile with no licence at all: in loops that branch lane by lane, and where NaN is looked for."""
    return _compile(function)


def entry(function: Function) -> Function:
    """Compile what Python calls: it lets other threads run meanwhile."""
    made: Any = _compile(function, nogil=True)
    if made is not function:
        made.compile = _faster(made.compile)
    return cast(Function, made)


def _faster(compile_signature: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Let numba compile in three quarters of the time.

    It makes millions of objects and hardly any garbage, and calls deeply. Python (3.11 to 3.14) takes memory for the
    frames of calls in pieces of 16 KiB, and gives each back at once: a loop that calls over such an edge asks the
    kernel for memory at each turn. A frame of 320 KB makes Python take a piece of 512 KiB, where the calls below fit.
    """

    def compile_in_roomy_frame(signature: Any) -> Any:
        with global_compiler_lock:
            collecting = gc.isenabled()
            gc.disable()
            try:
                return compile_signature(signature)
            finally:
                if collecting:
                    gc.enable()

    compile_in_roomy_frame.__code__ = compile_in_roomy_frame.__code__.replace(co_stacksize=40_000)
    return compile_in_roomy_frame


# A fork waits for what another thread compiles: its child has no such thread, and would wait for ever.
if sys.platform != "win32":
    os.register_at_fork(
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )
