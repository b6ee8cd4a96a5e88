"""What reaches the supervisor of messages that do not fit."""

import json
import os
import threading
from pathlib import Path
from typing import Any

from core.reasons import Reason
from worker.protocol import LONGEST_MESSAGE, Advanced, Failed, Measured, Message, Noted, Started
from worker.training.event_writer import EventWriter


class Short:
    """A pipe that takes at most 1,000 bytes of a write, as a signal may end it early."""

    def __init__(self) -> None:
        self.taken = b""

    def write(self, piece: memoryview) -> int:
        self.taken += bytes(piece[:1000])
        return min(len(piece), 1000)


def heard(tmp_path: Path, *messages: Message) -> list[dict[str, Any]]:
    """The lines that arrive."""
    reader, writer = os.pipe()
    sender = EventWriter(tmp_path, writer)
    thread = threading.Thread(target=lambda: [*map(sender.send, messages), sender._pipe.close()])
    thread.start()
    with os.fdopen(reader, "rb") as pipe:
        lines = pipe.readlines()
    thread.join()
    assert all(len(line) <= LONGEST_MESSAGE for line in lines)
    return [json.loads(line) for line in lines]


def test_a_write_that_a_signal_ends_early_is_continued(tmp_path: Path) -> None:
    """L6: two messages were lost."""
    sender = EventWriter(tmp_path, os.open(os.devnull, os.O_WRONLY))
    sender._pipe.close()
    sender._pipe = pipe = Short()  # type: ignore[assignment]
    sender.send(Noted(text="x" * 5000))
    sender.send(Noted(text="y"))
    assert [json.loads(line)["text"] for line in pipe.taken.splitlines()] == ["x" * 5000, "y"]


def test_metrics_that_are_too_many_for_a_message_come_in_several(tmp_path: Path) -> None:
    """L6: they were dropped."""
    values = {f"{number:06d}{'n' * 100}": float(number) for number in range(20_000)}
    lines = heard(tmp_path, Measured(step=7, values=values))
    assert {line["step"] for line in lines} == {7}
    assert {name: value for line in lines for name, value in line["values"].items()} == values


def test_what_is_too_long_is_cut_or_said(tmp_path: Path) -> None:
    """L6: a failure must arrive, and how far the training is."""
    long = "x" * LONGEST_MESSAGE
    failed, advanced, noted, left_out = heard(
        tmp_path,
        Failed(reason=Reason.TRAINING_CRASHED, message=long),
        Advanced(step=5, total=9, metrics={long: 1.0}),
        Noted(text=long),
        Started(device="cpu", engine="native", details={"long": long}),
    )
    assert (failed["type"], failed["reason"], failed["message"]) == (
        "failed",
        "training_crashed",
        long[:4000],
    )
    assert (advanced["step"], advanced["total"], advanced["metrics"]) == (5, 9, {})
    assert noted["text"] == long[:4000]
    assert left_out["type"] == "note"
    assert f"may have {LONGEST_MESSAGE}" in left_out["text"]
