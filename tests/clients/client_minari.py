"""Records two episodes with their infos as a data set and reads them back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import minari
import numpy as np
import pytest
from worm import EXTENSION, ID, N_STEP

import lattice_gym  # noqa: F401, registers the ids


@pytest.mark.parametrize("others", [{}, {"adaptation": {}, "randomise": {"strength": (0.9, 1.1)}}])
def test_episodes_are_kept_with_their_infos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, others: Any) -> None:
    """The start and every step, all numbers of them."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = minari.DataCollector(gymnasium.make(ID, **EXTENSION, **others), record_infos=True)
    told = []
    for seed in range(2):
        told.append(env.reset(seed=seed)[1])
        for _ in range(N_STEP):
            told.append(env.step(env.action_space.sample())[4])
    name = "worm/extension-v0"
    env.create_dataset(name, algorithm_name="random", author="nobody", author_email="nobody@example.org")
    env.close()
    kept = minari.load_dataset(name)
    assert (kept.total_episodes, kept.total_steps) == (2, 2 * N_STEP)
    infos = kept[1].infos
    assert set(infos) == set(told[0])
    for step, info in enumerate(told[N_STEP + 1 :]):
        assert infos["status"][step] == info["status"] == 0
        assert infos["outcome"]["strain"][step] == info["outcome"]["strain"]
        assert infos["reward_terms"]["effort"][step] == info["reward_terms"]["effort"]
        if others:
            np.testing.assert_array_equal(infos["factors"]["strength"][step], info["factors"]["strength"])
