"""How kernels are compiled, and for how long their machine code is kept.

Numba keeps machine code until the file of the function changes, though code of other files is compiled into it. Here
it is kept until any file of this folder changes, by a hash of them all in the names of its files. (In a stamp inside
them it would not do: numba reads a file before it compares stamps, and fails where a named tuple is no longer there.)
Where it is kept is for numba to say: `NUMBA_CACHE_DIR`, else `__pycache__`, else the user's folder for caches. With
`NUMBA_CACHE_LOCATOR_CLASSES` numba takes the locators named there, and edits of a helper may run stale code.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numba.core import caching

Function = TypeVar("Function", bound=Callable[..., Any])


@cache
def _folder_hash() -> str:
    """Hash of every source file of this folder, as they stood when the first kernel was defined, and numpy's version.

    Coefficients of series are made by numpy and compiled in.
    """
    folder, digest = resources.files(__package__), hashlib.sha256(np.__version__.encode())
    for name in sorted(file.name for file in folder.iterdir() if file.name.endswith(".py")):
        source = folder.joinpath(name).read_bytes()
        digest.update(f"{name} {len(source)} ".encode() + source)
    return digest.hexdigest()[:16]


@cache
def _remove_outdated(folder: str) -> None:
    """Remove machine code of earlier versions of these files; no other file's code is kept in the same folder."""
    for file in Path(folder).glob("*.nb[ic]"):
        if _folder_hash() not in file.name:
            with suppress(OSError):  # in use by another process, or not ours to remove
                file.unlink()


class _PerVersion:
    """Names files of machine code by the hash of the sources."""

    def ensure_cache_path(self) -> None:
        """Make the folder, or raise an OSError."""
        super().ensure_cache_path()  # type: ignore[misc]
        _remove_outdated(self.get_cache_path())  # type: ignore[attr-defined]

    def get_disambiguator(self) -> str:
        """Line of the function, and the hash."""
        return f"{super().get_disambiguator()}-{_folder_hash()}"  # type: ignore[misc]


class UserProvided(_PerVersion, caching.UserProvidedCacheLocator):
    """The folder `NUMBA_CACHE_DIR`."""


class InTree(_PerVersion, caching.InTreeCacheLocator):
    """The folder `__pycache__` beside the file."""


class UserWide(_PerVersion, caching.UserWideCacheLocator):
    """The user's folder for caches."""


class Zipped(_PerVersion, caching.ZipCacheLocator):
    """The user's folder for caches, where the package is in an archive."""


class _Files(caching.CompileResultCacheImpl):
    """Files of machine code that are named by the hash of the sources."""

    _locator_classes = [UserProvided, InTree, UserWide, Zipped]  # noqa: RUF012, as numba has it


class _Cache(caching.FunctionCache):
    """Machine code of one function of this folder."""

    _impl_class = _Files


def _compile(function: Function, **options: Any) -> Function:
    """Compile when first called, and keep the machine code.

    The cache is given to this one dispatcher: numba's setting of locators holds for the code of a whole process.
    """
    made: Any = njit(error_model="numpy", **options)(function)
    if made is not function:  # as it is with NUMBA_DISABLE_JIT
        files: Any = _Cache
        made._cache = files(function)
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
    return _compile(function, nogil=True)
