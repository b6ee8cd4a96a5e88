"""What a client may ask of DQN, and what is refused with its place."""

import re
from pathlib import Path
from typing import Any

import pytest

from core.algorithms.catalog import resolve
from core.algorithms.dqn.spec import DQNSpec
from core.environments import catalog
from core.errors import Rejected
from core.jobs.checks import check
from core.jobs.spec import JOB_SPEC
from core.jobs.store import JobStore
from core.jobs.submission import completed

TWO: dict[str, Any] = {"kind": "actions", "actions": [[0.0] * 8, [1.0] * 8]}


def refused(**changes: Any) -> Rejected:
    """Why the ant is not trained with this on a CPU."""
    with pytest.raises(Rejected) as refusal:
        resolve(DQNSpec.model_validate(changes), catalog.find("ant"), "cpu")
    return refusal.value


@pytest.mark.parametrize(
    ("changes", "sentence", "pointers"),
    [
        ({}, "Name an `action_set`: the action of ant is 8 continuous numbers", ["action_set"]),
        ({"action_set": {"kind": "arm_roles"}}, "ant offers no action set 'arm_roles'", ["action_set"]),
        (
            {"action_set": TWO, "epsilon": {"decay_decisions": 640_001}, "num_timesteps": 640_000},
            "decay_decisions = 640,001, and the run has 640,000 decisions",
            ["epsilon/decay_decisions"],
        ),
        (
            {"action_set": TWO, "epsilon": {"end": 0.0, "shape": "exponential"}},
            "never comes from or to 0",
            ["epsilon/shape"],
        ),
        (
            {"action_set": TWO, "num_envs": 10, "unroll_length": 8, "max_replay_size": 79},
            "it has to keep 8: 80 or more",
            ["max_replay_size", "num_envs", "unroll_length", "n_step"],
        ),
        (
            {"action_set": TWO, "num_envs": 10, "num_timesteps": 240, "min_replay_size": 241},
            "The run ends after 240 transitions",
            ["min_replay_size", "num_timesteps"],
        ),
        (
            # A transition has 27 + 1 + 3 floats, 124 bytes: 25,977,624 of them fit into 3 GiB.
            {"action_set": TWO, "num_envs": 1, "max_replay_size": 25_977_625},
            "max_replay_size = 25977625 transitions of ant take 3 GiB",
            ["max_replay_size"],
        ),
    ],
)
def test_what_does_not_go_together_is_refused_with_its_place(
    changes: dict[str, Any], sentence: str, pointers: list[str]
) -> None:
    told = refused(**changes)
    assert sentence in told.detail
    assert [problem.pointer for problem in told.problems] == [f"/algorithm/{name}" for name in pointers]


def test_several_gpus_are_refused() -> None:
    with pytest.raises(Rejected, match="dqn runs on one device, but the job asks for 2 GPUs"):
        DQNSpec().check_sharing(2)


def test_the_jobs_of_the_page_are_jobs(job_store: JobStore) -> None:
    page = (Path(__file__).parents[4] / "docs" / "dqn.md").read_text()
    found = re.findall(r"```json\n(.*?)```", page, re.DOTALL)
    assert len(found) == 2
    for job in found:
        check(completed(JOB_SPEC.validate_json(job)), job_store)
