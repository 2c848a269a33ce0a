"""Training with PPO, evaluation beside baselines, recorded rollouts, timings and the demo.

Programs, run from the repository's root: `python train.py`, `python -m agents.evaluation RUN`,
`python -m agents.rollouts RUN`, `python -m agents.benchmark`, `python -m agents.demo`. Where a package that they need
is missing they end with one line that says so.
"""

import sys
from importlib.util import find_spec

NEEDED = ("gymnasium", "numba", "numpy", "elastica", "stable_baselines3", "torch", "tensorboard", "tqdm", "tyro")

if _missing := [name for name in NEEDED if find_spec(name) is None]:
    sys.exit(
        f"error: {', '.join(_missing)} not installed for {sys.executable}: activate the environment that make demo"
        ' made (source .venv/bin/activate), or pip install ".[train,video]"'
    )
