"""What a training hands over for programs elsewhere."""

import io
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.algorithms.policy_file import read_policy, write_policy
from core.algorithms.ppo.spec import PPOSpec
from core.environments import catalog
from core.jobs.resolved import resolve_job
from core.jobs.spec import TrainSpec
from gaitway import exported_policy
from tests.exports import numpy_answers, onnx_answers, policy_file
from tests.probes import endless
from worker.training import exports
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter
from worker.training.exports import ExportWriter, PolicyInTraining

SEEN = np.random.default_rng(0).normal(0, 3, (20, 5)).astype(np.float32)
CORRIDOR = TrainSpec.model_validate({"environment": {"id": "corridor", "options": {"walker": "ant"}}})


def handed_over(
    spool: Path, policy: bytes, algorithm: str = "ppo", checkpoints: Sequence[int] = ()
) -> list[dict[str, Any]]:
    """The messages that follow this policy of the corridor's ant at some checkpoints, and at the end: 640."""
    read, write = os.pipe()
    events = EventWriter(spool, write)
    built = BuiltEnvironment(resolve_job(CORRIDOR), endless(), "cpu", "cpu", "native", "asked for")
    exports, step = ExportWriter(algorithm, built), 0
    trained = PolicyInTraining(TrainSpec(environment="ant"), events, lambda: step, lambda: policy)
    for now in checkpoints:
        step = now
        exports.keep_newest([trained])
    step = 640
    exports.keep_last(trained, policy)
    events._pipe.close()
    with os.fdopen(read, "rb") as pipe:
        return [json.loads(line) for line in pipe]


def test_a_network_is_kept_in_two_forms_with_its_contract(tmp_path: Path) -> None:
    policy = policy_file(PPOSpec.model_validate({"policy_hidden_layer_sizes": [4]}), SEEN, 2)
    said = handed_over(tmp_path, policy)
    assert [(message["name"], message["role"], message["step"]) for message in said] == [
        ("policy.npz", "export", 640),
        ("policy.onnx", "export", 640),
        ("simulation.json", "simulation", None),
    ]
    for_numpy, for_onnx = (tmp_path.joinpath(message["path"]).read_bytes() for message in said[:2])
    np.testing.assert_allclose(numpy_answers(for_numpy, SEEN), onnx_answers(for_onnx, SEEN), atol=1e-5)
    about = exported_policy.load(io.BytesIO(for_numpy)).about
    assert (about["algorithm"], about["trained_steps"]) == ("ppo", 640)
    # All options, also those that a job leaves out.
    info, options = catalog.resolve("corridor", {"walker": "ant"})
    assert about["environment"] == {"id": info.id, "options": options.model_dump(mode="json")}
    assert about["action"]["held_s"] == endless().dt


def test_a_running_job_has_the_policy_of_its_newest_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 0.0

    def monotonic() -> float:
        nonlocal now
        now += 1.0
        return now

    monkeypatch.setattr(exports.time, "monotonic", monotonic)
    policy = policy_file(PPOSpec.model_validate({"policy_hidden_layer_sizes": [4]}), SEEN, 2)
    # The second takes 1 s, which is a small share only of the time after the third.
    said = handed_over(tmp_path, policy, checkpoints=[160, 320, 480])
    assert [(message["name"], message["step"]) for message in said] == [
        ("simulation.json", None),
        ("policy.npz", 160),
        ("policy.npz", 320),
        ("policy.npz", 640),
        ("policy.onnx", 640),
    ]
    # The supervisor may store them later, so none is written over another.
    files = [tmp_path / message["path"] for message in said[1:4]]
    assert [exported_policy.load(file).about["trained_steps"] for file in files] == [160, 320, 640]


def test_the_contract_names_the_numbers_as_the_catalog_does(tmp_path: Path) -> None:
    policy = policy_file(PPOSpec.model_validate({"policy_hidden_layer_sizes": [4]}), np.zeros((2, 27)), 8)
    about = exported_policy.load(tmp_path / handed_over(tmp_path, policy)[0]["path"]).about
    info, _ = catalog.resolve("corridor", {"walker": "ant"})
    # The height, the trunk's rotation and eight joints; and an actuator for each of these.
    assert [(part["name"], part["size"]) for part in about["observation"]["parts"][:3]] == [
        ("qpos", 1),
        ("qpos", 4),
        ("qpos", 8),
    ]
    assert [part["name"] for part in about["action"]["parts"]] == [one.name for one in info.spaces.action]
    assert len(info.spaces.action) == 8


def test_a_table_is_left_to_its_own_file(tmp_path: Path) -> None:
    assert handed_over(tmp_path, b"a table", "q_learning", [320]) == []


def test_a_policy_that_cannot_be_written_is_a_note(tmp_path: Path) -> None:
    params = read_policy(policy_file(PPOSpec(), SEEN, 2))
    params.policy["params"]["LayerNorm_0"] = {"scale": np.ones(8), "bias": np.zeros(8)}
    said = handed_over(tmp_path, write_policy(params), checkpoints=[320])
    # Once, at the end.
    assert [message["type"] for message in said] == ["file", "note", "note"]
    assert "There is no policy.onnx" in said[2]["text"]
    assert "LayerNorm_0" in said[2]["text"]
