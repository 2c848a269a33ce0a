"""PPO and SAC with hindsight replay on `lattice_gym.sb3.WormVecEnv`, PPO on single worms, and a video."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import imageio.v3 as iio
import numpy as np
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize, VecVideoRecorder
from worm import EXTENSION, ID, N_STEP

from lattice_gym.sb3 import WormVecEnv


def _worms(id: str = ID, **others: Any) -> WormVecEnv:
    return WormVecEnv(gymnasium.make_vec(id, num_envs=2, autoreset_mode="SameStep", **EXTENSION | others))


def test_ppo_on_worms_together_and_apart() -> None:
    """Over the ends of episodes, which it counts."""
    check_env(gymnasium.make(ID, **EXTENSION).unwrapped)
    for worms in (VecNormalize(_worms()), make_vec_env(ID, 2, env_kwargs=EXTENSION)):
        model = PPO("MlpPolicy", worms, n_steps=2 * N_STEP, batch_size=N_STEP, device="cpu", seed=0)
        model.learn(4 * N_STEP)
        assert [episode["l"] for episode in model.ep_info_buffer or ()] == [N_STEP] * 4
        worms.close()


def test_sac_with_hindsight_replay() -> None:
    """On the worm with goals."""
    model = SAC(
        "MultiInputPolicy",
        _worms("LatticeWormReachGoal-v0", control="column"),
        learning_starts=2 * N_STEP,
        batch_size=N_STEP,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"copy_info_dict": True},
        buffer_size=100,
        device="cpu",
        seed=0,
    )
    model.learn(4 * N_STEP)
    assert model._n_updates > 0


def test_a_video_runs_as_fast_as_the_worm(tmp_path: Path) -> None:
    """20 frames a second in the file that the recorder wrote."""
    recorder = VecVideoRecorder(_worms(render_mode="rgb_array"), str(tmp_path), lambda step: step == 0, N_STEP)
    recorder.reset()
    for _ in range(N_STEP + 1):
        recorder.step(np.stack([recorder.action_space.sample() for _ in range(2)]))
    recorder.close()
    (video,) = tmp_path.glob("*.mp4")
    assert iio.immeta(video, plugin="FFMPEG")["fps"] == 20.0
