"""What a checkpoint holds of model and normalisation, read without unpickling anything.

model.zip is Stable-Baselines3's own file. Its weights and the state of its optimiser are torch's, which are read with
`weights_only=True`. What else is in it are pickles, and `PPO.load` unpickles them: code in them would run. Nothing here
does; do it by hand only with files that you trust.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize

from agents import run_folder
from agents.run_folder import read_file
from lattice_gym.checks import FloatArray, array
from lattice_gym.recording.archive import read_members, unpack, unpack_meta, write_archive

POLICY, OPTIMISER = "policy", "policy.optimizer"
"""Parts of model.zip."""
MOMENTS = ("mean", "var", "count")
SUBJECTS = {"observation": "obs_rms", "reward": "ret_rms"}
"""What is normalised, and where `VecNormalize` holds its moments."""


def files(model: PPO) -> Mapping[str, Callable[[Path], object]]:
    """Files of a checkpoint by name, and what writes each."""
    moments = {
        f"{subject}_{moment}": np.asarray(getattr(getattr(_normaliser(model), holder), moment), dtype=np.float64)
        for subject, holder in SUBJECTS.items()
        for moment in MOMENTS
    }
    return {
        run_folder.MODEL: lambda path: path.write_bytes(_saved(model)),
        run_folder.NORMALISATION: lambda path: write_archive(path, {}, moments),
    }


def restore(model: PPO, folder: Path) -> None:
    """Give a new model the weights, optimiser and normalisation of a checkpoint; InputError names a damaged file."""
    normaliser = _normaliser(model)
    moments = read_normalisation(folder)

    def take(path: Path) -> None:
        model.policy.load_state_dict(read_state(path, POLICY))
        model.policy.optimizer.load_state_dict(read_state(path, OPTIMISER))

    read_file(folder / run_folder.MODEL, take)
    for subject, holder in SUBJECTS.items():
        held: RunningMeanStd = getattr(normaliser, holder)
        shape = np.shape(held.mean)
        mean, variance, count = (moments[f"{subject}_{moment}"] for moment in MOMENTS)
        held.mean, held.var, held.count = mean.reshape(shape), variance.reshape(shape), float(count)


def read_state(path: Path, part: str) -> dict[str, Any]:
    """State of a part of model.zip by name; ValueError where a weight is not finite."""
    with zipfile.ZipFile(path) as archive:
        content = archive.read(f"{part}.pth")
    state: dict[str, Any] = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    tensors = [values for values in state.values() if isinstance(values, torch.Tensor)]
    if not all(bool(torch.isfinite(values).all()) for values in tensors):
        raise ValueError("a weight is not finite")
    return state


def read_normalisation(folder: Path) -> dict[str, FloatArray]:
    """Moments of observations and rewards by name; InputError names the file."""

    def read(path: Path) -> dict[str, FloatArray]:
        members = read_members(path)
        unpack_meta(members, ())
        given = unpack(members, [f"{subject}_{moment}" for subject in SUBJECTS for moment in MOMENTS])
        shape = given["observation_mean"].shape
        shapes = {"observation_mean": shape, "observation_var": shape}
        return {
            name: array(name, values, shapes.get(name, ()), *(() if "mean" in name else (0.0,)))
            for name, values in given.items()
        }

    return read_file(folder / run_folder.NORMALISATION, read)


def _saved(model: PPO) -> bytes:
    """Content of model.zip; written from memory, as torch tells of a full disk in a way of its own."""
    content = io.BytesIO()
    model.save(content)
    return content.getvalue()


def _normaliser(model: PPO) -> VecNormalize:
    normaliser = model.get_vec_normalize_env()
    assert normaliser is not None
    return normaliser
