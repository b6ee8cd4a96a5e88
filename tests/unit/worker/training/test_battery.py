"""What becomes of a battery at the end of a job; the numbers are those of tests/unit/algorithms."""

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from core.algorithms.battery.result import Quantity
from core.algorithms.ppo.spec import PPOSpec
from core.jobs.resolved import resolve_job
from core.jobs.spec import TrainSpec
from gaitway.battery import _NAMES as SHOWN  # pyright: ignore[reportPrivateUsage]
from gaitway.battery import shown_battery
from tests.exports import policy_file
from tests.probes import endless
from tests.unit.environments.mjcf.probe import XML, options
from tests.unit.environments.test_imitating_bodies import FOLLOWS, at_rest
from worker.training.battery import BatteryWriter
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter
from worker.training.exports import PolicyInTraining

TASK = options(
    command={"kind": "velocity"},
    reward=[{"kind": "track_linear_velocity"}],
    observation=[{"kind": "command"}],
    termination=[],
)
SPEC = TrainSpec.model_validate(
    {"environment": {"id": "mjcf", "options": TASK}, "battery": {"starts": 1, "seconds": 2.0}}
)
SEEN = np.random.default_rng(0).normal(0, 1, (20, 3)).astype(np.float32)
POLICY = policy_file(PPOSpec.model_validate({"policy_hidden_layer_sizes": [4]}), SEEN, 1)
# The policy as it was when the training began.
BEFORE = policy_file(PPOSpec.model_validate({"policy_hidden_layer_sizes": [4]}), 2 * SEEN, 1)


def told(
    spool: Path,
    policy: bytes = POLICY,
    seeds: Sequence[int | None] = (None,),
    *,
    stopped: bool = False,
    prepared: bool = False,
) -> list[dict[str, Any]]:
    """The messages of the batteries of some seeds' policies, trained for 640 steps."""
    (spool / "model").write_bytes(XML)
    read, write = os.pipe()
    events = EventWriter(spool, write)
    job = resolve_job(SPEC)
    built = BuiltEnvironment(job, endless(), "cpu", "cpu", "compiled", "asked for", model=spool / "model")
    assert SPEC.battery is not None
    policies = [
        PolicyInTraining(
            SPEC, events if seed is None else events.of_seed(seed), lambda: 640, lambda: policy, seed
        )
        for seed in seeds
    ]
    writer = BatteryWriter(SPEC.battery, built, lambda: stopped)
    if prepared:
        writer.prepare(replace(policies[0], content=lambda: BEFORE))
    writer.test_trained(policies)
    events._pipe.close()
    with os.fdopen(read, "rb") as pipe:
        return [json.loads(line) for line in pipe]


def test_a_body_of_the_catalog_that_imitates_is_tested_by_its_clips(tmp_path: Path) -> None:
    clips = at_rest("rodent", tmp_path / "clips.npz")
    spec = TrainSpec.model_validate(
        {
            "environment": {"id": "rodent", "options": FOLLOWS},
            "battery": {"starts": 1, "push": {"speed": 0.1}},
        }
    )
    job = resolve_job(spec)
    built = BuiltEnvironment(job, endless(), "cpu", "cpu", "compiled", "asked for", clips=clips)
    seen = np.random.default_rng(0).normal(0, 1, (20, job.info.observation_size)).astype(np.float32)
    network = PPOSpec.model_validate({"policy_hidden_layer_sizes": [4]})
    policy = policy_file(network, seen, job.info.action_size)
    read, write = os.pipe()
    events = EventWriter(tmp_path, write)
    assert spec.battery is not None
    writer = BatteryWriter(spec.battery, built, lambda: False)
    writer.test_trained([PolicyInTraining(spec, events, lambda: 0, lambda: policy)])
    events._pipe.close()
    with os.fdopen(read, "rb") as pipe:
        [file, metrics] = [json.loads(line) for line in pipe]
    [clip] = json.loads((tmp_path / file["path"]).read_bytes())["clips"]
    assert (clip["clip"], clip["episodes"]) == ("rest", 1)
    assert metrics["values"]["battery/reached"] == clip["reached"]


def test_a_battery_becomes_a_file_with_what_is_shown_of_it_and_metrics(tmp_path: Path) -> None:
    file, metrics = told(tmp_path, prepared=True)
    assert (file["name"], file["role"], file["step"]) == ("battery.json", "battery", 640)
    whole = json.loads((tmp_path / file["path"]).read_bytes())
    assert whole["engine"] == "native"
    assert whole["environment"]["options"]["command"]["kind"] == "velocity"
    assert set(whole["versions"]) >= {"gaitway", "mujoco"}
    assert metrics["values"]["battery/passed"] == 0
    assert set(metrics["values"]) == {
        "battery/passed",
        "battery/falls",
        "battery/linear_tracking",
        "battery/angular_tracking",
    }
    for facts in (whole, file["metadata"]):
        shown = shown_battery(facts)
        assert shown is not None
        assert shown.verdict.startswith("Not passed: 2 s under each command")
        assert [row[:2] for row in shown.rows][:2] == [("1, 0, 0", "0/1"), ("0.5, 0, 0", "0/1")]
    assert shown_battery({"criteria": 3}) is None


@pytest.mark.extra
def test_each_seed_has_a_battery_and_a_plain_metric_is_their_mean(tmp_path: Path) -> None:
    messages = told(tmp_path, seeds=[3, 5])
    files = [one["name"] for one in messages if one["type"] == "file"]
    assert files == ["battery-seed-3.json", "battery-seed-5.json"]
    rows = [one["values"] for one in messages if one["type"] == "metrics"]
    assert ["seed_3/battery/falls" in row for row in rows] == [True, False, False]
    assert rows[-1]["battery/linear_tracking"] == pytest.approx(rows[0]["seed_3/battery/linear_tracking"])


def test_an_error_in_a_battery_is_a_note(tmp_path: Path) -> None:
    (note,) = told(tmp_path, policy=b"no policy")
    assert note["type"] == "note"
    assert note["text"].startswith("There is no battery: ")


def test_a_stopped_battery_leaves_nothing_but_a_note(tmp_path: Path) -> None:
    (note,) = told(tmp_path, stopped=True)
    assert note["text"] == "There is no battery: the job was stopped meanwhile."
    assert not (tmp_path / "battery.json").exists()


def test_the_client_shows_every_quantity_in_its_order() -> None:
    assert tuple(SHOWN) == get_args(Quantity)
