"""Which evaluation's policy is kept beside the last one."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from core.algorithms.events import Evaluated
from core.algorithms.ppo.spec import PPOSpec
from core.jobs.resolved import resolve_job
from core.jobs.spec import TrainSpec
from gaitway import exported_policy
from tests.exports import policy_file
from tests.probes import endless
from worker.protocol import BestSoFar
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter
from worker.training.exports import ExportWriter, PolicyInTraining
from worker.training.policy_files import BestPolicy

BEFORE = BestSoFar(path="from-before", step=50, episode_return=4.0)


def kept(
    spool: Path, returns: Sequence[float | None], before: BestSoFar | None = None
) -> list[tuple[int, float, bytes]]:
    """Step, return and content of each policy that is kept, of evaluations at the steps 100, 200, …."""
    said = messages(spool, returns, before, lambda step: b"of step %d" % step)
    assert {(message["name"], message["role"]) for message in said} <= {("policy-best", "best_policy")}
    return [
        (message["step"], message["metadata"]["return"], (spool / message["path"]).read_bytes())
        for message in said
    ]


def messages(
    spool: Path, returns: Sequence[float | None], before: BestSoFar | None, policy: Any, *, ends: bool = False
) -> list[dict[str, Any]]:
    read, write = os.pipe()
    events, step = EventWriter(spool, write), 0
    trained = PolicyInTraining(TrainSpec(environment="ant"), events, lambda: step, lambda: policy(step))
    best = BestPolicy(trained, before)
    for step, value in zip(range(100, 10_000, 100), returns, strict=False):
        best.see(Evaluated(step, {} if value is None else {"eval/episode_reward": value}))
    if ends:
        job = resolve_job(
            TrainSpec.model_validate({"environment": {"id": "corridor", "options": {"walker": "ant"}}})
        )
        built = BuiltEnvironment(job, endless(), "cpu", "cpu", "native", "asked for")
        best.keep_exports(ExportWriter("ppo", built))
    events._pipe.close()
    with os.fdopen(read, "rb") as pipe:
        return [json.loads(line) for line in pipe]


def test_each_better_evaluation_replaces_the_one_before(tmp_path: Path) -> None:
    # Neither a worse one (2, -5), nor an equal one, nor one without a return.
    assert kept(tmp_path, [-3.0, 2.0, -5.0, 2.0, None, 2.5, 1.0]) == [
        (100, -3.0, b"of step 100"),
        (200, 2.0, b"of step 200"),
        (600, 2.5, b"of step 600"),
    ]


def test_each_seed_is_compared_by_its_own_return(tmp_path: Path) -> None:
    read, write = os.pipe()
    events, spec = EventWriter(tmp_path, write), TrainSpec(environment="ant")
    best = [
        BestPolicy(PolicyInTraining(spec, events.of_seed(seed), lambda: 1, lambda: b"own", seed), None)
        for seed in (4, 2)
    ]
    for step, returns in ((100, {4: 1.0, 2: 2.0}), (200, {4: 3.0, 2: 1.0}), (300, {2: 5.0})):
        own = {f"seed_{seed}/eval/episode_reward": value for seed, value in returns.items()}
        for one in best:
            one.see(Evaluated(step, {"eval/episode_reward": 9.0, **own}))
    events._pipe.close()
    with os.fdopen(read, "rb") as pipe:
        said = [json.loads(line) for line in pipe]
    assert [(message["name"], message["step"], message["metadata"]["return"]) for message in said] == [
        ("policy-best-seed-4", 100, 1.0),
        ("policy-best-seed-2", 100, 2.0),
        ("policy-best-seed-4", 200, 3.0),
        ("policy-best-seed-2", 300, 5.0),
    ]


def test_what_an_attempt_before_kept_is_replaced_by_a_better_one_alone(tmp_path: Path) -> None:
    (tmp_path / BEFORE.path).write_bytes(b"of step 50")
    assert kept(tmp_path, [3.0, 4.0], BEFORE) == []
    assert kept(tmp_path, [3.0, 4.5, 4.0], BEFORE) == [(200, 4.5, b"of step 200")]


def test_a_training_without_evaluations_keeps_none(tmp_path: Path) -> None:
    assert messages(tmp_path, [], None, None, ends=True) == []


def test_at_the_end_the_best_one_is_there_for_programs_elsewhere(tmp_path: Path) -> None:
    seen = np.zeros((2, 27), np.float32)
    policy = policy_file(PPOSpec.model_validate({"policy_hidden_layer_sizes": [4]}), seen, 8)
    said = messages(tmp_path, [1.0, 5.0, 2.0], None, lambda _: policy, ends=True)
    names = [(message["name"], message["step"]) for message in said]
    assert names[2:] == [("policy-best.npz", 200), ("policy-best.onnx", 200)]
    assert exported_policy.load(tmp_path / "policy-best.npz").about["trained_steps"] == 200


def test_so_is_the_one_of_an_attempt_before(tmp_path: Path) -> None:
    seen = np.zeros((2, 27), np.float32)
    content = policy_file(PPOSpec.model_validate({"policy_hidden_layer_sizes": [4]}), seen, 8)
    (tmp_path / BEFORE.path).write_bytes(content)
    said = messages(tmp_path, [1.0], BEFORE, None, ends=True)
    names = [(message["name"], message["step"]) for message in said]
    assert names == [("policy-best.npz", 50), ("policy-best.onnx", 50)]
