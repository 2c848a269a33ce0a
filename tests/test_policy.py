"""A trained policy as arrays: equal to the model that it came from, and to itself after its file."""

from __future__ import annotations

import copy
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
import torch
from stable_baselines3 import A2C, PPO, SAC
from stable_baselines3.common.vec_env import VecNormalize

import agents
import lattice_gym
from agents.config import InputError, TrainConfig
from agents.environments import make_vector_env
from agents.evaluation import evaluate
from agents.evaluation import main as evaluation_main
from agents.export import main as export_main
from agents.rollouts import export as export_rollout
from agents.run_folder import Run
from agents.training import train
from lattice_gym import NetworkPolicy, load_policy, network_policy

pytestmark = pytest.mark.slow

ARGUMENTS: dict[str, Any] = {"id": "LatticeWormExtension-v0", "control": "ring", "fidelity": "fast"}
N_SEEN, N_ACTION = 296, 8
TINY: dict[str, Any] = {
    "task": "extension",
    "fidelity": "fast",
    "control": "ring",
    "total_steps": 80,
    "seed": 3,
    "n_envs": 1,
    "n_steps": 80,
    "batch_size": 40,
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run folder of a tiny run."""
    return train(TrainConfig(**TINY, run_dir=tmp_path_factory.mktemp("runs") / "run"))


@pytest.fixture(scope="module")
def worms() -> Any:
    """One worm as the learner sees it."""
    return make_vector_env(ARGUMENTS, 1)


def _model(worms: Any, kind: Any = PPO, normalised: bool = True, **settings: Any) -> Any:
    """Untrained model whose actions reach beyond their bounds, of observations with moments of any size."""
    model = kind("MlpPolicy", VecNormalize(worms) if normalised else worms, seed=0, device="cpu", **settings)
    generator = np.random.default_rng(5)
    with torch.no_grad():
        for name, values in model.policy.named_parameters():
            if name == "action_net.weight":
                values *= 100.0
            elif name.endswith("bias"):
                values += torch.as_tensor(generator.normal(0.0, 0.3, values.shape), dtype=torch.float32)
    if normalised:
        moments = model.get_vec_normalize_env().obs_rms
        moments.mean = generator.normal(0.0, 1.0, N_SEEN)
        moments.var = generator.uniform(0.0, 2.0, N_SEEN) ** 6
    return model


def _observations(count: int = 300) -> npt.NDArray[np.float32]:
    return np.random.default_rng(1).normal(0.0, 3.0, (count, N_SEEN)).astype(np.float32)


def _assert_acts_alike(policy: NetworkPolicy, model: Any, scaled: Any, seen: Any) -> None:
    """Compare actions with those of the model, and with its network reckoned in double precision.

    From the latter they differ by one rounding to float32. What is left between them and the model is the model's own
    rounding: float32 carries seven digits, of sums of up to 300 products, into an output layer made 100 times as steep.
    """
    hidden, last = copy.deepcopy([model.policy.mlp_extractor.policy_net, model.policy.action_net])
    with torch.no_grad():
        exact = last.double()(hidden.double()(torch.as_tensor(scaled).double())).numpy()
    acted, expected = policy(seen), model.predict(scaled, deterministic=True)[0]
    assert acted.dtype == expected.dtype == np.float32
    np.testing.assert_allclose(acted, np.clip(exact, -1.0, 1.0), rtol=2.0**-24, atol=1e-12)
    np.testing.assert_allclose(acted, expected, rtol=0.0, atol=2e-5)


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        (PPO, {}),
        (PPO, {"policy_kwargs": {"net_arch": [64, 64]}, "normalised": False}),
        (PPO, {"policy_kwargs": {"net_arch": [8]}}),
        (PPO, {"policy_kwargs": {"net_arch": [48, 32, 16, 8]}}),
        (PPO, {"policy_kwargs": {"net_arch": []}}),
        (PPO, {"policy_kwargs": {"net_arch": {"pi": [16, 32], "vf": [8]}}}),
        (PPO, {"policy_kwargs": {"net_arch": [32], "activation_fn": torch.nn.ReLU}}),
        (PPO, {"use_sde": True}),
        (PPO, {"use_sde": True, "policy_kwargs": {"net_arch": [16], "full_std": False}}),
        (A2C, {}),
    ],
    ids=str,
)
def test_acts_as_stable_baselines_does(worms: Any, kind: Any, settings: dict[str, Any]) -> None:
    """To the rounding of float32, clipped actions among them."""
    model, seen = _model(worms, kind, **settings), _observations()
    normaliser, policy = model.get_vec_normalize_env(), network_policy(model)
    _assert_acts_alike(policy, model, seen if normaliser is None else normaliser.normalize_obs(seen), seen)
    assert 0.1 < (np.abs(policy(seen)) == 1.0).mean() < 0.9
    assert policy(seen).std() > 0.3


def test_a_batch_is_its_rows(worms: Any) -> None:
    """To the last bit, whatever its length."""
    policy, seen = network_policy(_model(worms)), _observations(64)
    alone = np.array([policy(one) for one in seen])
    assert alone.shape == (64, N_ACTION)
    np.testing.assert_array_equal(policy(seen), alone)
    np.testing.assert_array_equal(policy(seen[:7]), alone[:7])
    np.testing.assert_array_equal(policy(np.asfortranarray(seen)), alone)
    assert policy(seen[:0]).shape == (0, N_ACTION)
    assert policy(seen[0].tolist()).shape == (N_ACTION,)


def test_file_gives_the_same_policy(worms: Any, tmp_path: Path) -> None:
    """To the last bit, and by numpy without pickle."""
    policy = network_policy(_model(worms), {**ARGUMENTS, "action_range": [-1, 1]}, {"note": "by hand"})
    policy.save(tmp_path / "policy.npz")
    again = load_policy(tmp_path / "policy.npz")
    np.testing.assert_array_equal(again(_observations()), policy(_observations()))
    assert (again.environment, again.origin) == (policy.environment, policy.origin)
    assert repr(again) == "NetworkPolicy(296 -> 64 -> 64 -> 8, tanh)"
    with np.load(tmp_path / "policy.npz", allow_pickle=False) as file:
        assert file["weight_0"].shape == (64, N_SEEN)
        assert json.loads(file["meta"].item())["environment"]["id"] == ARGUMENTS["id"]
    with pytest.raises(ValueError, match="read-only"):
        again.weights[0][0, 0] = 1.0


def test_run_folder_gives_the_policy_of_its_model(run: Path) -> None:
    """And `agents.load_policy` reads it without unpickling; its actions are those of the worm that it names."""
    policy = agents.load_policy(run)
    checkpoint = Run.open(run).newest
    model = PPO.load(checkpoint / "model.zip", device="cpu")
    moments = np.load(checkpoint / "normalisation.npz", allow_pickle=False)
    seen = _observations(50)
    scaled = np.clip((seen - moments["observation_mean"]) / np.sqrt(moments["observation_var"] + 1e-8), -10.0, 10.0)
    _assert_acts_alike(policy, model, scaled.astype(np.float32), seen)
    env = gymnasium.make(**policy.environment)
    assert env.action_space == model.action_space
    assert env.observation_space == model.observation_space
    assert policy.origin["steps"] == 80
    assert policy.origin["seeds"] == [[3, 3]]


@pytest.fixture(scope="module")
def exported(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """File of that policy."""
    file = tmp_path_factory.mktemp("exported") / "policy.npz"
    export_main(run, file)
    return file


def test_file_is_scored_like_its_run(run: Path, exported: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """To the last bit, baselines included; the report stands beside the file."""
    scores = evaluate(run, episodes=2)
    assert evaluate(exported, episodes=2) == scores
    report = json.loads(exported.with_name("policy-evaluation.json").read_text())
    of_run = json.loads((run / "evaluation.json").read_text())
    assert report.pop("made").keys() == of_run.pop("made").keys()
    assert report == of_run
    with pytest.raises(InputError, match=r"^seed = 3: episodes must not have those of training, 3 to 3"):
        evaluate(exported, episodes=1, seed=3)
    evaluation_main(exported, episodes=1, fidelity="default")
    assert f"fidelity default; written to {exported.parent}/policy-evaluation-default.json" in capsys.readouterr().out


def test_file_is_filmed_like_its_run(exported: Path, tmp_path: Path) -> None:
    """Beside it, under its name; the learning curve is the run's alone."""
    policy, file = load_policy(exported), tmp_path / "policy.npz"
    replace(policy, environment={**policy.environment, "max_episode_steps": 4}).save(file)
    files = export_rollout(file, seed=11, gif=(0.1, 0.2))
    assert [path.name for path in files.paths().values()] == [
        "policy-policy-11.npz",
        "policy-policy-11.mp4",
        "policy-policy-11-activation.png",
        "policy-policy-11.gif",
    ]
    assert all(path.parent == tmp_path and path.stat().st_size > 0 for path in files.paths().values())


def test_numpy_alone_plays_it(run: Path, exported: Path) -> None:
    """In a process that has neither Stable-Baselines3 nor torch: the same return, to the last bit."""
    code = (
        "import sys; sys.modules['torch'] = sys.modules['stable_baselines3'] = None\n"
        "import lattice_gym\n"
        f"policy = lattice_gym.load_policy({str(exported)!r})\n"
        "print(lattice_gym.evaluate(policy, policy.environment, seeds=[7]).returns[0].hex())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    policy = agents.load_policy(run)
    assert done.stdout.split() == [lattice_gym.evaluate(policy, policy.environment, seeds=[7]).returns[0].hex()]


@pytest.mark.parametrize("ends", [(0.0, 1.0), (-3.0, 0.5)])
def test_policy_of_another_range(run: Path, tmp_path: Path, ends: tuple[float, float]) -> None:
    """Acts in that range, and commands the same to rounding."""
    policy = agents.load_policy(run)
    other = policy.in_range(*ends)
    seen = _observations(50)
    acted = (other(seen).astype(np.float64) - ends[0]) / (ends[1] - ends[0])
    np.testing.assert_allclose(acted, 0.5 * (policy(seen).astype(np.float64) + 1.0), rtol=0.0, atol=2.0**-22)
    same = policy.in_range(-1.0, 1.0)
    np.testing.assert_array_equal(same(seen), policy(seen))
    file = tmp_path / "further.json"
    file.write_text(json.dumps({"action_range": ends}))
    trained = train(TrainConfig(**TINY, environment=file, run_dir=tmp_path / "run"))  # the same but for the file
    np.testing.assert_allclose(agents.load_policy(trained)(seen), other(seen), rtol=0.0, atol=1e-4)
    assert evaluate(trained, episodes=1)["policy"].return_mean == pytest.approx(
        evaluate(run, episodes=1)["policy"].return_mean, rel=1e-4
    )


def test_range_of_a_run_that_is_none(run: Path, tmp_path: Path) -> None:
    """A spoilt file of further arguments is told of by the argument."""
    copy = Path(shutil.copytree(run, tmp_path / "run"))
    for ends in ("01", [1, -1], None, 7):
        (copy / "environment.json").write_text(json.dumps({"action_range": ends}))
        for use in (agents.load_policy, evaluate):
            with pytest.raises(InputError, match=r"^action_range = "):
                cast(Any, use)(copy)


def _squashed(worms: Any) -> Any:
    return _model(worms, use_sde=True, policy_kwargs={"squash_output": True})


def _recurrent(worms: Any) -> Any:
    model = _model(worms)
    model.policy.lstm_actor = torch.nn.LSTM(1, 1)
    return model


def _with_goals(_: Any) -> Any:
    arguments = {"id": "LatticeWormReachGoal-v0", "control": "column", "fidelity": "fast"}
    return PPO("MultiInputPolicy", make_vector_env(arguments, 1), seed=0, device="cpu")


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda worms: SAC("MlpPolicy", worms, buffer_size=10, device="cpu"), "SAC has no actor of the kind"),
        (lambda worms: None, "NoneType has no actor of the kind"),
        (lambda worms: _model(worms, policy_kwargs={"activation_fn": torch.nn.ELU}), "stand ELU, not Tanh, ReLU"),
        (_squashed, "are squashed"),
        (_recurrent, "its actor is recurrent"),
        (_with_goals, "its observations go through a CombinedExtractor"),
        (lambda worms: PPO("MlpPolicy", "CartPole-v1", device="cpu"), "come from a CategoricalDistribution"),
    ],
)
def test_what_cannot_be_exported_is_refused(worms: Any, make: Callable[[Any], Any], why: str) -> None:
    """The error says which part, and how to use the model all the same."""
    with pytest.raises(ValueError, match=rf"^model: cannot be written as a NetworkPolicy, as .*{why}.*lambda seen"):
        network_policy(make(worms))


GOOD: dict[str, Any] = {
    "weights": (np.ones((3, 2)), np.ones((1, 3))),
    "biases": (np.zeros(3), np.zeros(1)),
    "shift": np.zeros(2),
    "scale": np.ones(2),
    "limit": np.array(10.0),
    "low": -np.ones(1),
    "high": np.ones(1),
}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"weights": ()}, r"weights = \(\): must have at least one layer"),
        ({"weights": (np.ones((3, 2)),)}, r"biases = .*must be a sequence of 1 arrays"),
        ({"weights": (np.ones((3, 2)), np.ones((1, 4)))}, r"weights\[1\] has shape \(1, 4\): must have \(1, 3\)"),
        ({"biases": (np.zeros(2), np.zeros(1))}, r"biases\[0\] has shape \(2,\): must have \(3,\)"),
        ({"shift": np.zeros(3)}, r"shift has shape \(3,\): must have \(2,\)"),
        ({"scale": np.zeros(2)}, "scale: must be above 0"),
        ({"scale": np.array([1.0, np.nan])}, r"scale\[1\] = nan"),
        ({"limit": np.array(-1.0)}, "limit: must be above 0"),
        ({"low": np.array([2.0])}, "low: must not be above high"),
        ({"activation": "selu"}, "activation = 'selu': must be one of tanh, relu"),
        ({"activation": ["tanh"]}, "activation = .*must be one of"),
        ({"environment": [1]}, "environment = .*must be a mapping"),
        ({"weights": (np.array([["a", "b"]] * 3), np.ones((1, 3)))}, r"weights\[0\] = .*must be an array of real"),
    ],
)
def test_arrays_must_fit(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    """Each error names the array, whether they are given or read."""
    with pytest.raises(ValueError, match=rf"(?s)^NetworkPolicy\.{message}"):
        NetworkPolicy(**GOOD | changes)


def test_observations_must_fit() -> None:
    """Another number of them, one whose goals are apart, or text."""
    policy = NetworkPolicy(**GOOD)
    assert policy([0.0, 0.0]).tolist() == [0.0]
    wrong: list[Any] = [np.zeros(3), np.zeros((2, 3)), np.zeros((1, 1, 2)), 0.0, ["a", "b"], {"observation": 1}]
    for seen in wrong:
        with pytest.raises(ValueError, match=r"^observation\b"):
            policy(seen)


def test_environment_must_fit(run: Path) -> None:
    """The error says which range, or which shapes."""
    policy = agents.load_policy(run)
    with pytest.raises(ValueError, match=r"^policy: gives actions from -1 to 1, .* 0 to 1: make it with action_range="):
        lattice_gym.evaluate(policy, ARGUMENTS, seeds=[1])
    with pytest.raises(ValueError, match=r"^policy: observations and actions have shape \(\(296,\), \(8,\)\), those"):
        lattice_gym.evaluate(policy, {**ARGUMENTS, "control": "muscle"}, seeds=[1])
    with pytest.raises(ValueError, match=r"^policy: observations and actions have shape .* \(None, \(24,\)\)"):
        lattice_gym.evaluate(policy, {"id": "LatticeWormReachGoal-v0", "control": "column", "fidelity": "fast"}, [1])


@pytest.mark.parametrize("value", [np.zeros(2), {"a": {1, 2}}, lattice_gym.LatticeDesign()])
def test_environment_must_be_json(value: Any, tmp_path: Path) -> None:
    """Before anything is written."""
    policy = NetworkPolicy(**GOOD, environment={"id": "LatticeWorm-v0", "command": value})
    with pytest.raises(ValueError, match=r"^NetworkPolicy\.environment.*: must hold what JSON does"):
        policy.save(tmp_path / "policy.npz")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[: len(content) // 2],
        lambda content: b"\0" * 100,
        lambda content: content.replace(b"bias_1", b"bias_7"),
    ],
)
def test_damaged_file_is_named(damage: Callable[[bytes], bytes], tmp_path: Path) -> None:
    """By every reader."""
    file = tmp_path / "policy.npz"
    NetworkPolicy(**GOOD, environment={"id": "LatticeWorm-v0"}).save(file)
    assert load_policy(file).environment == {"id": "LatticeWorm-v0"}
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(ValueError, match=r"policy\.npz: "):
        load_policy(file)
    for program in (evaluation_main, export_rollout):
        with pytest.raises(InputError, match=r"policy\.npz: "):
            cast(Any, program)(file)


def test_programs_name_what_they_cannot_use(run: Path, tmp_path: Path) -> None:
    """A missing file, one that does not say its environment, a file name of another kind."""
    NetworkPolicy(**GOOD).save(tmp_path / "bare.npz")
    for path, message in ((tmp_path / "absent.npz", "no such file"), (tmp_path / "bare.npz", "does not say which")):
        with pytest.raises(InputError, match=message):
            evaluate(path, episodes=1)
    file = tmp_path / "noted.npz"
    notes: list[Any] = [5, "ab", [[1]], [[1, "b"]], [[-1, 2]], {"1": 2}]
    for seeds in notes:
        NetworkPolicy(**GOOD, environment={"id": "LatticeWorm-v0"}, origin={"seeds": seeds}).save(file)
        with pytest.raises(InputError, match=r"noted\.npz: origin: seeds"):
            evaluate(file, episodes=1)
    with pytest.raises(InputError, match="no such run folder"):
        export_main(file, tmp_path / "policy.npz")
    with pytest.raises(InputError, match=r"^file = .*policy\.zip: must end in \.npz"):
        export_main(run, tmp_path / "policy.zip")
    with pytest.raises(InputError, match="no such run folder"):
        export_main(tmp_path / "absent", tmp_path / "policy.npz")
