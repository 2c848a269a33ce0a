"""Machine code of the kernels, kept from one process to the next.

It is only for speed: what cannot be read or is damaged is compiled anew, and what cannot be kept is compiled by each
process. It is kept in `NUMBA_CACHE_DIR`, else in `__pycache__` beside the kernels, else in the user's folder for
caches. A file's name holds the hash of all sources that are compiled into it. (Numba's own cache keeps code until the
file of the function changes, though code of other files is in it; it starts nowhere where it can write nowhere, and a
damaged file stops it at each start.)
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import uuid
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import caching, compiler, serialize
from numba.misc import appdirs

# Numba has no types for what follows.
_NUMBA: Any = numba
_USER_CACHE_DIR: Callable[..., str] = appdirs.user_cache_dir
_DUMPS: Callable[[Any], bytes] = serialize.dumps
_REBUILD: Callable[..., Any] = compiler.CompileResult._rebuild
_CHECKSUM = hashlib.sha256
_CHECKSUM_SIZE = _CHECKSUM().digest_size


def folders(sources: Path) -> list[Path]:
    """Folders where machine code of the kernels of a folder may be kept, the first choice first."""
    own = f"lattice_gym-{hashlib.sha256(os.fsencode(sources)).hexdigest()[:16]}"
    if _NUMBA.config.CACHE_DIR:
        return [Path(_NUMBA.config.CACHE_DIR, own)]
    caches = Path(_USER_CACHE_DIR("numba", False))
    # Where there is no home, the path begins with "~".
    return [sources / "__pycache__", *([caches / own] if caches.is_absolute() else [])]


class MachineCode(caching._Cache):
    """Machine code of one function, a file for each signature and processor.

    Parameters
    ----------
    function
        No closure: its source is all that tells it from others.
    version
        Hash of all sources that are compiled into it.
    """

    def __init__(self, function: Callable[..., Any], version: str) -> None:
        assert function.__closure__ is None, function
        source = Path(function.__code__.co_filename)
        self._prefix = f"{source.stem}.{function.__qualname__}-{version}-"
        self._version = version
        self._folders = folders(source.parent)

    @property
    def cache_path(self) -> str:
        """The folder of the first choice."""
        return str(self._folders[0])

    def enable(self) -> None:
        """Do nothing: it is always in use."""

    def disable(self) -> None:
        """Do nothing: it is always in use."""

    def flush(self) -> None:
        """Do nothing: files of other versions are removed when the first of this one is kept."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Machine code for a signature, or None."""
        target_context.refresh()  # numba has it so: the context may not know all types yet
        name = self._name(sig, target_context.codegen())
        for folder in self._folders:
            file = folder / name
            try:
                content = file.read_bytes()
            except OSError:
                continue
            checksum, code = content[:_CHECKSUM_SIZE], content[_CHECKSUM_SIZE:]
            # The loader of machine code would crash on a damaged file. What else it or pickle raises, we compile.
            if _CHECKSUM(code).digest() == checksum:
                with suppress(Exception):
                    return _REBUILD(target_context, *pickle.loads(code))
            with suppress(OSError):
                file.unlink()
        _say_that_it_compiles()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the machine code for a signature, or warn once that it cannot be kept."""
        if data.library.has_dynamic_globals:
            return
        name = self._name(sig, data.codegen)
        code = _DUMPS(data._reduce())
        errors = []
        for folder in self._folders:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                _remove_other_versions(folder, self._version)
                _write_whole(folder / name, _CHECKSUM(code).digest() + code)
            except OSError as error:
                errors.append(str(error))
            else:
                return
        _warn_that_nothing_is_kept("; ".join(errors))

    def _name(self, signature: Any, codegen: Any) -> str:
        """Name of the file for a signature and this processor, Python and numba."""
        key = (str(signature), codegen.magic_tuple(), sys.version, numba.__version__)
        return f"{self._prefix}{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"


def _write_whole(file: Path, content: bytes) -> None:
    """Write a file that another process sees whole or not at all."""
    part = file.with_name(f"{file.name}.{uuid.uuid4().hex[:8]}.part")
    try:
        part.write_bytes(content)
        part.replace(file)
    except OSError:
        part.unlink(missing_ok=True)
        raise


@cache
def _remove_other_versions(folder: Path, version: str) -> None:
    """Remove machine code of other versions of the sources; no other file's code is kept in the same folder."""
    for pattern in ("*.nb[ic]", "*.nbc.*.part"):
        for file in folder.glob(pattern):
            if version not in file.name:
                with suppress(OSError):  # in use by another process, or not ours to remove
                    file.unlink()


@cache
def _say_that_it_compiles() -> None:
    print(
        "lattice_gym: compiling for this processor, once: about 10 s, on a busy machine 30 s",
        file=sys.stderr,
        flush=True,
    )


@cache
def _warn_that_nothing_is_kept(errors: str) -> None:
    warnings.warn(
        f"compiled code can be kept nowhere ({errors}), so that each process compiles anew, for 10 s or more: "
        "set NUMBA_CACHE_DIR to a folder that can be written",
        RuntimeWarning,
        stacklevel=2,
    )
