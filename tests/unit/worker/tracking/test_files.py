"""The files that are written of a whole job for other tools."""

import io
import json
from pathlib import Path

from worker.tracking.__main__ import write
from worker.tracking.items import WriteUp


def test_a_file_that_cannot_be_written_costs_a_note_and_no_other_file(tmp_path: Path) -> None:
    row = {"step": 1, "time": "2026-11-21T12:00:00Z", "values": {"training/epsilon": 0.5}}
    (tmp_path / "rows").write_text(json.dumps(row) + "\n")
    nowhere = tmp_path / "nowhere"
    task = WriteUp(
        job_id="j", measurements=tmp_path / "rows", events=nowhere / "events", curve=nowhere / "curve.png"
    )
    words = io.StringIO()
    assert write(task, words) == 1
    notes = [json.loads(line)["note"] for line in words.getvalue().splitlines()]
    assert notes[0].startswith("There is no event file for TensorBoard: FileNotFoundError")
    (tmp_path / "nowhere").mkdir()
    assert write(task, words) == 0
    assert task.events.stat().st_size > 0
