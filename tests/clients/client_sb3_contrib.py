"""TQC and recurrent PPO on `lattice_gym.sb3.WormVecEnv`."""

from __future__ import annotations

import gymnasium
from sb3_contrib import TQC, RecurrentPPO
from worm import EXTENSION, ID, N_STEP

from lattice_gym.sb3 import WormVecEnv


def test_tqc_and_recurrent_ppo() -> None:
    """A few updates each."""
    worms = WormVecEnv(gymnasium.make_vec(ID, num_envs=2, autoreset_mode="SameStep", **EXTENSION))
    tqc = TQC("MlpPolicy", worms, learning_starts=N_STEP, batch_size=N_STEP, device="cpu", seed=0)
    tqc.learn(2 * N_STEP)
    assert tqc._n_updates > 0
    ppo = RecurrentPPO("MlpLstmPolicy", worms, n_steps=N_STEP, batch_size=N_STEP, device="cpu", seed=0)
    ppo.learn(4 * N_STEP)
    assert ppo.num_timesteps == 4 * N_STEP
    worms.close()
