"""Training with PPO, evaluation beside baselines, recorded rollouts, exported policies, timings and the demo.

Programs, run from the repository's root: `python train.py`, `python -m agents.evaluation POLICY`,
`python -m agents.rollouts POLICY`, `python -m agents.export RUN FILE`, `python -m agents.benchmark`,
`python -m agents.demo`. Where a package that they need is missing they end with one line that says so.

`load_policy` gives the policy of a run as a callable.
"""

import sys
from importlib.util import find_spec

NEEDED = ("gymnasium", "numba", "numpy", "elastica", "stable_baselines3", "torch", "tensorboard", "tqdm", "tyro")

if _missing := [name for name in NEEDED if find_spec(name) is None]:
    sys.exit(
        f"error: {', '.join(_missing)} not installed for {sys.executable}: activate the environment that make demo"
        ' made (source .venv/bin/activate), or pip install ".[train,video]"'
    )

from agents.policies import load_policy  # noqa: E402, after the line that says what is missing

__all__ = ["load_policy"]
