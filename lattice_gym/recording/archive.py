"""Files of arrays and one JSON text, which any numpy reads, and which hold no code: nothing in them is unpickled."""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from lattice_gym.recording.files import checked_path, write

META = "meta"
"""Name of the JSON text among the arrays."""


def write_archive(
    path: str | os.PathLike[str], meta: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]
) -> None:
    """Write an .npz file; it replaces a file of that name once it is complete."""
    members = {META: np.array(json.dumps(meta, allow_nan=False)), **arrays}
    content = io.BytesIO()  # where the disk is full, a half written archive cannot be closed
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in members.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.asanyarray(values), allow_pickle=False)
    write(path, content.getvalue())


def read_members(path: str | os.PathLike[str]) -> dict[str, bytes]:
    """Members of a file by name, not yet interpreted; a ValueError names a file that is damaged or none of these."""
    content = checked_path("path", path).read_bytes()
    try:
        # Members are unpacked whole, so that their checksums are compared before a byte of them is interpreted.
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            return {name: archive.read(name) for name in archive.namelist()}
    except Exception as error:  # Damage surfaces as any of a dozen exceptions of zipfile and its decompressors.
        raise ValueError(f"{path}: damaged, or not an .npz file: {error}") from error


def unpack(members: Mapping[str, bytes], names: Iterable[str]) -> dict[str, npt.NDArray[Any]]:
    """Arrays of floating-point numbers by name, from members that are exactly these and the JSON text."""
    known = list(names)
    expected = {f"{name}.npy" for name in (META, *known)}
    if set(members) != expected:
        raise ValueError(f"it holds {', '.join(sorted(members)) or 'nothing'}; must hold {', '.join(sorted(expected))}")
    arrays = {name: _array(members, name) for name in known}
    for name, values in arrays.items():
        if values.dtype.kind != "f":
            raise ValueError(f"{name} holds {values.dtype}: must hold floating-point numbers")
    return arrays


def unpack_meta(members: Mapping[str, bytes], names: Iterable[str]) -> dict[str, Any]:
    """Read what the JSON text says, by exactly these names."""
    known = list(names)
    text = _array(members, META)
    if text.shape != () or text.dtype.kind != "U":
        raise ValueError(f"meta is an array of {text.dtype} with shape {text.shape}: must be one text")
    meta = json.loads(text.item())
    if not isinstance(meta, dict) or set(meta) != set(known):
        raise ValueError(f"meta must be a mapping of {', '.join(known)}")
    return meta


def _array(members: Mapping[str, bytes], name: str) -> npt.NDArray[Any]:
    values: npt.NDArray[Any] = np.lib.format.read_array(io.BytesIO(members[f"{name}.npy"]), allow_pickle=False)
    return values
