"""Exported policies: what the files say, and that they act as the network that was trained."""

import io
import math
import re
import shutil
import subprocess
import sys
from itertools import product
from pathlib import Path
from typing import Any, get_args

import numpy as np
import onnx
import pytest

from core.algorithms.export.contract import PolicyOrigin, contract
from core.algorithms.export.network import NotExportable, PolicyLayer, PolicyNetwork, network_of
from core.algorithms.export.onnx_file import onnx_file
from core.algorithms.policy_file import read_policy, write_policy
from core.algorithms.ppo.spec import Activation, PPOSpec
from core.algorithms.sac.spec import SACSpec
from gaitway import exported_policy
from tests.exports import (
    ORIGIN,
    Numbers,
    assert_acts_as_in_jax,
    files,
    jax_answers,
    numpy_answers,
    onnx_answers,
    policy_file,
)

SPECS = {"ppo": PPOSpec, "sac": SACSpec}
OPTIONS: tuple[dict[str, Any], ...] = (
    {},
    {"normalize_observations_max_abs_value": 0.5},
    {"normalize_observations": False, "normalize_observations_max_abs_value": 0.5},
    {"action_repeat": 3},
    {"policy_hidden_layer_sizes": [5]},
)


def some(size: int, num: int = 1000) -> Numbers:
    """Observations far from the origin, of different spreads."""
    spread = np.geomspace(0.1, 100, size)
    return np.random.default_rng(0).normal(5, spread, (num, size)).astype(np.float32)


def settings(algorithm: str = "ppo", **options: Any) -> PPOSpec | SACSpec:
    return SPECS[algorithm].model_validate({"policy_hidden_layer_sizes": [8, 4], **options})


def of_one_layer(*, max_abs: float | None = None, action_repeat: int = 1) -> PolicyNetwork:
    """(o − 1) / 2 is seen; the location is a quarter of that and 0.3, the scale is always 0."""
    layer = PolicyLayer(np.array([[0.25, 0.0]], np.float32), np.array([0.3, 0.0], np.float32))
    one, two = np.array([1.0], np.float32), np.array([2.0], np.float32)
    return PolicyNetwork(one, two, max_abs, (layer,), "relu", "state", action_repeat)


@pytest.mark.parametrize("activation", get_args(Activation))
def test_any_activation_acts_as_in_jax(activation: str) -> None:
    assert_acts_as_in_jax(settings(activation=activation), some(5), 2)


@pytest.mark.parametrize(
    ("algorithm", "options"),
    [*product(SPECS, OPTIONS)],
)
def test_a_policy_under_any_option_acts_as_in_jax(algorithm: str, options: dict[str, Any]) -> None:
    assert_acts_as_in_jax(settings(algorithm, **options), some(5), 2)


def test_a_policy_with_an_encoder_acts_as_in_jax() -> None:
    network = {"kind": "intention", "latent": 3, "encoder": [6], "decoder": [7], "places": [[3, 1], [0, 2]]}
    chosen = settings(network=network, normalize_observations_max_abs_value=2.0)
    assert_acts_as_in_jax(chosen, some(5), 2)
    about = contract(network_of(policy_file(chosen, some(5), 2)), ORIGIN)
    # Readers of the first version would leave the encoder out.
    assert (about["version"], about["network"]["encoder"]["encoded"]) == (2, [3, 0, 1])


@pytest.mark.parametrize(("own", "values"), [("state", "other"), ("other", "state")])
def test_of_several_observations_a_policy_takes_its_own(own: str, values: str) -> None:
    chosen = settings(policy_obs_key=own, value_obs_key=values)
    seen = {"state": some(5), "other": some(3)}
    assert_acts_as_in_jax(chosen, seen, 2)
    network = network_of(policy_file(chosen, seen, 2))
    about = contract(network, ORIGIN)
    assert (about["observation"]["name"], about["observation"]["size"]) == (own, seen[own].shape[1])


@pytest.mark.parametrize(
    ("max_abs", "expected"),
    # (9 − 1) / 2 = 4 deviations, a bound of 2 makes them 2; tanh(4/4 + 0.3) and tanh(2/4 + 0.3).
    [(None, math.tanh(1.3)), (2.0, math.tanh(0.8))],
)
def test_the_numbers_are_those_of_the_definition(max_abs: float | None, expected: float) -> None:
    for_numpy, for_onnx = files(of_one_layer(max_abs=max_abs))
    seen = np.array([[9.0]], np.float32)
    np.testing.assert_allclose(numpy_answers(for_numpy, seen), [[expected]], rtol=1e-6)
    np.testing.assert_allclose(onnx_answers(for_onnx, seen), [[expected]], rtol=1e-6)


def test_with_noise_the_action_is_drawn_as_in_training() -> None:
    act = exported_policy.load(io.BytesIO(files(of_one_layer())[0]))
    drawn = np.arctanh(act(np.full((20_000, 1), 1.0), np.random.default_rng(0)))
    # At the mean the location is 0.3; the deviation is softplus(0) + 0.001 = ln 2 + 0.001.
    deviation = math.log(2) + 0.001
    assert np.mean(drawn) == pytest.approx(0.3, abs=4 * deviation / math.sqrt(20_000))
    assert np.std(drawn) == pytest.approx(deviation, rel=0.02)


def test_a_single_observation_and_any_batch_are_taken() -> None:
    for_numpy, for_onnx = files(network_of(policy_file(settings(), some(5), 2)))
    batch = some(5, 6)
    whole = numpy_answers(for_numpy, batch)
    np.testing.assert_allclose(numpy_answers(for_numpy, batch[0].tolist()), whole[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(
        numpy_answers(for_numpy, batch.reshape(2, 3, 5)), whole.reshape(2, 3, 2), rtol=0, atol=1e-6
    )
    np.testing.assert_allclose(onnx_answers(for_onnx, batch[:1]), whole[:1], rtol=0, atol=1e-6)


def test_the_contract_is_in_both_files() -> None:
    parts = [{"name": "height", "start": 0, "size": 1, "unit": "m"}]
    origin = PolicyOrigin("sac", "ant", {"a": 1}, step_s=0.05, trained_steps=7, observation_parts=parts)
    network = of_one_layer(max_abs=2.0, action_repeat=3)
    for_numpy, for_onnx = files(network, origin)
    about = exported_policy.load(io.BytesIO(for_numpy)).about
    assert about == contract(network, origin)
    model = onnx.load_from_string(for_onnx)
    assert {entry.key: entry.value for entry in model.metadata_props} == {
        "about": str(np.load(io.BytesIO(for_numpy))["about"])
    }
    assert (about["format"], about["version"], about["algorithm"]) == ("gaitway-policy", 1, "sac")
    assert about["environment"] == {"id": "ant", "options": {"a": 1}}
    assert about["observation"] == {"name": "state", "size": 1, "dtype": "float32", "parts": parts}
    whole = [{"name": "action", "start": 0, "size": 1, "unit": None}]
    # An action is held for three steps of 0.05 s.
    assert about["action"] == {
        "size": 1,
        "dtype": "float32",
        "low": -1.0,
        "high": 1.0,
        "parts": whole,
        "held_steps": 3,
        "held_s": 0.15,
    }
    assert about["network"] == {"num_layers": 1, "activation": "relu", "normalized_max_abs": 2.0}


def test_equal_policies_give_equal_files() -> None:
    content = policy_file(settings(), some(5), 2)
    assert files(network_of(content)) == files(network_of(content))


def test_the_loader_needs_numpy_alone(tmp_path: Path) -> None:
    shutil.copy(exported_policy.__file__, tmp_path / "policy_loader.py")
    (tmp_path / "policy.npz").write_bytes(files(of_one_layer())[0])
    program = (
        "import sys, numpy.random\nsys.path.insert(0, '.')\n"
        "before = {n.partition('.')[0] for n in sys.modules}\n"
        "import policy_loader; print(policy_loader.load('policy.npz')([9.0])[0])\n"
        "new = {n.partition('.')[0] for n in sys.modules} - before - sys.stdlib_module_names\n"
        "assert new == {'policy_loader'}, new"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert float(done.stdout) == pytest.approx(math.tanh(1.3))


@pytest.mark.parametrize("number", range(3))
def test_the_programs_of_the_page_run(tmp_path: Path, number: int) -> None:
    pytest.importorskip("onnxruntime")
    seen, content = some(5), policy_file(settings(), some(5), 2)
    for name, body in zip(("policy.npz", "policy.onnx"), files(network_of(content)), strict=True):
        (tmp_path / name).write_bytes(body)
    shown = {"episode_0/observation": seen, "episode_0/action": jax_answers("ppo", content, seen[:-1])}
    np.savez(tmp_path / "trajectory.npz", **shown)
    page = (Path(__file__).parents[3] / "docs" / "export.md").read_text()
    programs = [text for text in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "trajectory" in text]
    assert len(programs) == 3
    subprocess.run([sys.executable, "-W", "error", "-c", programs[number]], cwd=tmp_path, check=True)


@pytest.mark.parametrize("about", [None, '{"format": "gaitway-policy", "version": 3}', '{"format": "other"}'])
def test_the_loader_refuses_other_files(about: str | None) -> None:
    file = io.BytesIO()
    np.savez(file, **({} if about is None else {"about": np.array(about)}))
    file.seek(0)
    with pytest.raises(ValueError, match="not a gaitway-policy of version 1"):
        exported_policy.load(file)


def test_the_loader_refuses_an_observation_of_another_size() -> None:
    act = exported_policy.load(io.BytesIO(files(of_one_layer())[0]))
    with pytest.raises(ValueError, match=r"the shape \(2,\), and not \[..., 1\]"):
        act([1.0, 2.0])


def test_a_network_with_other_parts_is_refused() -> None:
    params = read_policy(policy_file(settings(), some(5), 2))
    params.policy["params"]["LayerNorm_0"] = {"scale": np.ones(8), "bias": np.zeros(8)}
    with pytest.raises(NotExportable, match="LayerNorm_0"):
        network_of(write_policy(params))


def test_a_network_that_no_onnx_file_holds_is_refused() -> None:
    # 4 · 25,000² bytes = 2.5 GB, which one number in memory stands for.
    kernel = np.broadcast_to(np.float32(0), (25_000, 25_000))
    layer = PolicyLayer(kernel, np.zeros(25_000, np.float32))
    zeros = np.zeros(25_000, np.float32)
    network = PolicyNetwork(zeros, zeros, None, (layer,), "relu", "state", 1)
    with pytest.raises(NotExportable, match="an ONNX file holds 2 GiB"):
        onnx_file(network, {})
