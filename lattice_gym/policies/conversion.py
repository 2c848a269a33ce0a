"""From a model of Stable-Baselines3 to a `NetworkPolicy`: weights and normalisation, and nothing else of it.

Neither Stable-Baselines3 nor torch is imported: a model brings along what is asked of it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from lattice_gym.checks import FloatArray
from lattice_gym.policies.network import NetworkPolicy

ACTIVATION_MODULES = {"Tanh": "tanh", "ReLU": "relu"}
"""Activations by the name of their module in torch."""
UNBOUNDED = float(np.finfo(np.float32).max)
"""Bound of observations that are not normalised."""
_INSTEAD = "; wrap it, lambda seen: model.predict(seen, deterministic=True)[0], to evaluate, record or film it as it is"


def network_policy(
    model: Any, environment: Mapping[str, Any] | None = None, origin: Mapping[str, Any] | None = None
) -> NetworkPolicy:
    """Policy that acts as a model of Stable-Baselines3 does with `deterministic=True`, to rounding.

    Parameters
    ----------
    model
        PPO, A2C or another algorithm whose "MlpPolicy" has a Gaussian (or gSDE) without squashing, for flat
        observations, with layers of any widths and tanh or ReLU between. Its `VecNormalize`, if any, comes along.
    environment
        Arguments of `gymnasium.make` for the worm. With `sb3.WormVecEnv` the model acts in [-1, 1]: give "action_range"
        [-1, 1] among them.
    origin
        Notes on its training.

    Raises
    ------
    ValueError
        What is no such model; it says which part is not.
    """
    policy: Any = getattr(model, "policy", None)
    if not hasattr(policy, "mlp_extractor") or not hasattr(policy, "action_net"):
        raise _refused(f"{type(model).__name__} has no actor of the kind that PPO's MlpPolicy has")
    if hasattr(policy, "lstm_actor"):
        raise _refused("its actor is recurrent")
    if type(policy.features_extractor).__name__ != "FlattenExtractor":
        raise _refused(f"its observations go through a {type(policy.features_extractor).__name__}")
    if policy.squash_output or type(policy.action_dist).__name__ not in (
        "DiagGaussianDistribution",
        "StateDependentNoiseDistribution",
    ):
        raise _refused(f"its actions come from a {type(policy.action_dist).__name__}, or are squashed")
    applied = {type(module).__name__ for module in policy.mlp_extractor.policy_net} - {"Linear"}
    if len(applied) > 1 or not applied <= ACTIVATION_MODULES.keys():
        raise _refused(f"between its layers stand {', '.join(sorted(applied))}, not {', '.join(ACTIVATION_MODULES)}")
    activation = ACTIVATION_MODULES[applied.pop()] if applied else "tanh"
    normaliser = model.get_vec_normalize_env()
    if normaliser is None or not normaliser.norm_obs:
        moments = {}
    elif not hasattr(normaliser.obs_rms, "mean"):
        raise _refused("its normalisation is not that of one array")
    else:
        seen = normaliser.obs_rms
        moments = normalisation(seen.mean, seen.var, normaliser.epsilon, normaliser.clip_obs)
    state = {name: values.detach().cpu().numpy() for name, values in policy.state_dict().items()}
    space = model.action_space
    return from_state(state, activation, moments, space.low, space.high, environment or {}, origin or {})


def from_state(
    state: Mapping[str, Any],
    activation: str,
    moments: Mapping[str, FloatArray],
    low: FloatArray,
    high: FloatArray,
    environment: Mapping[str, Any],
    origin: Mapping[str, Any],
) -> NetworkPolicy:
    """Policy from arrays under the names that an MlpPolicy's `state_dict` has.

    `moments` is what `normalisation` gives; empty: observations are not normalised.
    """
    hidden = [name for name in state if re.fullmatch(r"mlp_extractor\.policy_net\.\d+\.weight", name)]
    layers = [name.removesuffix(".weight") for name in sorted(hidden, key=lambda name: int(name.split(".")[2]))]
    layers.append("action_net")
    needed = [f"{layer}.{part}" for layer in layers for part in ("weight", "bias")]
    if missing := [name for name in needed if name not in state]:
        raise ValueError(f"it lacks {', '.join(missing)}")
    weights = tuple(state[f"{layer}.weight"] for layer in layers)
    if not moments:
        n_seen = weights[0].shape[-1]
        moments = {"shift": np.zeros(n_seen), "scale": np.ones(n_seen), "limit": np.array(UNBOUNDED)}
    return NetworkPolicy(
        weights=weights,
        biases=tuple(state[f"{layer}.bias"] for layer in layers),
        activation=activation,
        low=low,
        high=high,
        environment=environment,
        origin=origin,
        **moments,
    )


def normalisation(mean: FloatArray, variance: FloatArray, epsilon: float, clip: float) -> dict[str, FloatArray]:
    """Return the normalisation of `VecNormalize`, to the last bit, as arrays of a `NetworkPolicy`."""
    return {"shift": mean, "scale": np.sqrt(variance + epsilon), "limit": np.array(clip)}


def _refused(why: str) -> ValueError:
    return ValueError(f"model: cannot be written as a NetworkPolicy, as {why}{_INSTEAD}")
