"""What a training tells its job, besides what the trainer tells."""

import json
import os
from pathlib import Path

from core.algorithms.events import Progress
from tests.learning.runs import small_run
from tests.probes import endless
from worker.training.event_writer import EventWriter
from worker.training.train import Report


def test_contacts_that_are_lost_are_warned_of_once_and_told_each_time(tmp_path: Path) -> None:
    read, write = os.pipe()
    events = EventWriter(tmp_path, write)
    report = Report(events, small_run(endless()))
    for step, lost in enumerate([0.0, 0.1, 0.2]):
        report.publish(Progress(step, 3, {"training/physics_overflow": lost}))
    events._pipe.close()
    with os.fdopen(read, "rb") as pipe:
        said = [json.loads(line) for line in pipe]
    notes = [message["text"] for message in said if message["type"] == "note"]
    assert len(notes) == 1
    assert "By step 1" in notes[0]
    assert "contacts were lost" in notes[0]
    rows = [message["values"] for message in said if message["type"] == "metrics"]
    assert [row["training/physics_overflow"] for row in rows] == [0.0, 0.1, 0.2]
