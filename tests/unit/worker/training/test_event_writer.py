"""What reaches the supervisor of messages that do not fit."""

import json
import os
import threading
from pathlib import Path
from typing import Any

from core.reasons import Reason
from worker.protocol import LONGEST_MESSAGE, Failed, Measured, Message, Noted, Started
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
    """L6: a failure must arrive."""
    long = "x" * LONGEST_MESSAGE
    failed, noted, left_out = heard(
        tmp_path,
        Failed(reason=Reason.TRAINING_CRASHED, message=long),
        Noted(text=long),
        Started(device="cpu", engine="native", details={"long": long}),
    )
    assert (failed["type"], failed["reason"], failed["message"]) == (
        "failed",
        "training_crashed",
        long[:4000],
    )
    assert noted["text"] == long[:4000]
    assert left_out["type"] == "note"
    assert f"may have {LONGEST_MESSAGE}" in left_out["text"]


def test_a_seeds_files_have_its_suffix_and_what_the_seeds_share_is_kept_once(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    events = EventWriter(tmp_path, writer)
    for seed in (0, 5):
        own = events.of_seed(seed)
        own.keep("policy-best.npz", b"of %d" % seed, "export", "", step=7, metadata={"return": 1.0})
        own.keep("policy-best.npz", b"again of %d" % seed, "export", "", step=8)
        own.keep("scene.glb", b"the scene", "scene", "")
        (tmp_path / "video.mp4").write_bytes(b"video of %d" % seed)
        own.hand_over("video.mp4", "video", "", step=8, metadata={"fps": 30})
    events.keep("checkpoint", b"of all", "checkpoint", "")
    events._pipe.close()
    with os.fdopen(reader, "rb") as pipe:
        files = [json.loads(line) for line in pipe]
    kept = [(file["name"], (tmp_path / file["path"]).read_bytes(), file["metadata"]) for file in files]
    assert kept == [
        ("policy-best-seed-0.npz", b"of 0", {"return": 1.0, "seed": 0}),
        ("policy-best-seed-0.npz", b"again of 0", {"seed": 0}),
        ("scene.glb", b"the scene", {}),
        ("video-seed-0.mp4", b"video of 0", {"fps": 30, "seed": 0}),
        ("policy-best-seed-5.npz", b"of 5", {"return": 1.0, "seed": 5}),
        ("policy-best-seed-5.npz", b"again of 5", {"seed": 5}),
        ("video-seed-5.mp4", b"video of 5", {"fps": 30, "seed": 5}),
        ("checkpoint", b"of all", {}),
    ]
