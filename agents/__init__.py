"""Training with PPO, evaluation beside baselines, recorded rollouts, timings and the demo.

Run from the repository's root: `python train.py`, `python -m agents.evaluation RUN`, `python -m agents.rollouts RUN`,
`python -m agents.benchmark`, `python -m agents.demo`.
"""
