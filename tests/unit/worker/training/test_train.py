"""What a training tells its job, besides what the trainer tells."""

import json
import os
from pathlib import Path

import pytest

from core.algorithms.events import Progress
from tests.learning.runs import small_run
from tests.probes import endless
from worker.training.event_writer import EventWriter
from worker.training.train import Report


@pytest.mark.parametrize(
    ("metric", "words"),
    [
        ("training/physics_overflow", "contacts were lost"),
        ("training/lost_bodies", "an engine lost the state of a body"),
    ],
)
def test_what_was_lost_is_warned_of_once_and_told_each_time(metric: str, words: str, tmp_path: Path) -> None:
    read, write = os.pipe()
    events = EventWriter(tmp_path, write)
    report = Report(events, small_run(endless()))
    for step, lost in enumerate([0.0, 0.1, 0.2]):
        report.publish(Progress(step, 3, {metric: lost}))
    events._pipe.close()
    with os.fdopen(read, "rb") as pipe:
        said = [json.loads(line) for line in pipe]
    notes = [message["text"] for message in said if message["type"] == "note"]
    assert len(notes) == 1
    assert "By step 1" in notes[0]
    assert words in notes[0]
    rows = [message["values"] for message in said if message["type"] == "metrics"]
    assert [row[metric] for row in rows] == [0.0, 0.1, 0.2]
