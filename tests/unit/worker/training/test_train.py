"""What a training tells its job, besides what the trainer tells."""

import json
import math
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import pytest

from core.algorithms.events import TrainingProgress
from core.errors import JobFailed
from core.jobs.spec import JOB_SPEC
from core.reasons import Reason
from tests.learning.runs import small_run
from tests.probes import Probe, endless
from worker.protocol import MESSAGE, Advanced, FileReady, Measured, MemoryPeak, Noted, Started, Task
from worker.training import train
from worker.training.built_environment import build_environment
from worker.training.event_writer import EventWriter
from worker.training.roll_out import roll_out
from worker.training.train import Report


@pytest.mark.parametrize(
    ("metric", "words"),
    [
        ("training/physics_overflow", "no room for all contacts"),
        ("training/lost_bodies", "an engine lost the state of a body"),
    ],
)
def test_what_was_lost_is_warned_of_once_and_told_each_time(metric: str, words: str, tmp_path: Path) -> None:
    read, write = os.pipe()
    events = EventWriter(tmp_path, write)
    report = Report(events, small_run(endless()))
    for step, lost in enumerate([0.0, 0.1, 0.2]):
        report.publish(TrainingProgress(step, 3, {metric: lost}))
    events._pipe.close()
    with os.fdopen(read, "rb") as pipe:
        said = [json.loads(line) for line in pipe]
    notes = [message["text"] for message in said if message["type"] == "note"]
    assert len(notes) == 1
    assert "By step 1" in notes[0]
    assert words in notes[0]
    rows = [message["values"] for message in said if message["type"] == "metrics"]
    assert [row[metric] for row in rows] == [0.0, 0.1, 0.2]


def test_the_most_memory_that_a_run_has_had_is_told_when_it_grows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, write = os.pipe()
    report = Report(EventWriter(tmp_path, write), small_run(endless()))
    for step, peak in enumerate([None, 1000, 1005, 1000, 1200]):  # A hundredth more is no news.
        monkeypatch.setattr(train, "_device_memory", lambda name, peak=peak: peak)
        report.publish(TrainingProgress(step, 5, {}))
    report.events._pipe.close()
    with os.fdopen(read, "rb") as pipe:
        said = [MESSAGE.validate_json(line) for line in pipe]
    assert [message.bytes for message in said if isinstance(message, MemoryPeak)] == [1000, 1200]


def test_m2_a_training_whose_only_bad_number_is_one_metric_keeps_its_progress(tmp_path: Path) -> None:
    """As the audit's nan_message.py reads them: pydantic writes null, which the reader refused."""
    read, write = os.pipe()
    events = EventWriter(tmp_path, write)
    report = Report(events, small_run(endless()))
    for step, value in enumerate([math.nan, math.inf, 3.0]):
        report.publish(TrainingProgress(step, 3, {"training/bad": value, "training/good": 1.0}))
    events._pipe.close()
    with os.fdopen(read, "rb") as pipe:
        said = [MESSAGE.validate_json(line) for line in pipe]
    rows = [message.values for message in said if isinstance(message, Measured)]
    bad = [{"training/bad": None, "training/good": 1.0}] * 2
    assert rows == [*bad, {"training/bad": 3.0, "training/good": 1.0}]
    progress = [message for message in said if isinstance(message, Advanced)]
    assert [message.step for message in progress] == [0, 1, 2]
    (note,) = [message.text for message in said if isinstance(message, Noted)]
    assert "By step 0, the metric training/bad was not finite" in note


def test_m2_no_message_is_lost_because_a_number_in_it_is_not_finite() -> None:
    nan = math.nan
    for message in (
        Advanced(step=1, total=2, steps_per_second=nan, eta_s=nan),
        Measured(step=1, values={"a": nan, "b": 1.0}),
        Started(device="cpu", engine="native", details={"hyperparameters": {"a": nan, "b": [nan]}}),
        FileReady(name="v", path="v", role="video", media_type="", metadata={"forward_speed_m_s": nan}),
    ):
        assert type(MESSAGE.validate_json(message.model_dump_json())) is type(message)


def _bursts(_: Any, time: Any, __: Any) -> tuple[Any, Any]:
    """A reward that is no number from the third step on."""
    return jnp.where(time >= 2, jnp.nan, 1.0), jnp.float32(0)


def test_m2_a_rollout_that_is_not_finite_ends_as_diverged_with_the_step_and_the_quantity(
    tmp_path: Path,
) -> None:
    """As the audit's rollout_nan.py runs it: it was told as finished, with NaN in summary.json."""
    document = {"kind": "rollout", "environment": "inverted_pendulum", "policy": {"kind": "zero"}}
    spec = JOB_SPEC.validate_python({**document, "num_steps": 5, "num_episodes": 2, "video": None})
    task = Task(job_id="j", attempt=1, spec=spec, device="cpu")
    built = replace(build_environment(task), environment=Probe(_bursts))
    read, write = os.pipe()
    events = EventWriter(tmp_path, write)
    never: Any = SimpleNamespace(asked=False)
    with pytest.raises(JobFailed, match="The reward became non-finite at step 3 of episode 0") as failed:
        roll_out(task, spec, built, events, never)
    events._pipe.close()
    os.close(read)
    assert failed.value.reason == Reason.DIVERGED
    assert failed.value.facts == {"step": 3, "quantity": "reward"}
    assert not (tmp_path / "summary.json").exists()
