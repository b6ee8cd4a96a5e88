"""What a training process says, on its way to the record."""

import threading
import time
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.errors import RecordsUnavailable
from core.jobs.attempts import Claim, claim_attempt, new_secret
from core.jobs.job import Progress, utc_now
from core.jobs.spec import JOB_SPEC
from core.jobs.store import Channel, Entry
from core.jobs.submission import submit
from tests.faults.bench import wait_until
from tests.feeds import read_feed
from tests.in_memory import MemoryJobQueue, MemoryObjectStore
from worker.protocol import (
    Advanced,
    FileReady,
    Hello,
    Measured,
    MemoryPeak,
    Noted,
    PhaseBegan,
    PhaseEnded,
    Started,
)
from worker.supervision.outbox import Outbox

A_DAY_S = 86_400.0


@pytest.fixture
def claim(job_store: PostgresJobStore) -> Claim:
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant"})
    job = submit(spec, store=job_store, queue=MemoryJobQueue())
    objects, lease = MemoryObjectStore(), timedelta(seconds=15)
    claim = claim_attempt(job.id, 1, "w", store=job_store, objects=objects, lease=lease, secret=new_secret())
    assert claim is not None
    return claim


class Outage:
    """The record takes nothing until it is over. writes: how many entries each one had that it took."""

    def __init__(self, store: PostgresJobStore, patch: pytest.MonkeyPatch) -> None:
        self.is_over = False
        self.writes: list[tuple[Channel, int]] = []
        self._record = store.record
        patch.setattr(store, "record", self._take)

    def _take(
        self, job_id: str, token: str, channel: Channel, entries: Any, *rest: Any, **named: Any
    ) -> None:
        if not self.is_over:
            raise RecordsUnavailable("The test switched it off.")
        self._record(job_id, token, channel, entries, *rest, **named)
        self.writes.append((channel, len(entries)))


@pytest.fixture
def outage(job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch) -> Outage:
    return Outage(job_store, monkeypatch)


@pytest.fixture
def outbox(claim: Claim, tmp_path: Path) -> Outbox:
    return Outbox(claim, tmp_path, keep_checkpoints=1)


def read(claim: Claim, channel: Channel) -> list[Entry]:
    found = read_feed(claim.job_id, channel, store=claim.store, objects=claim.objects)
    return [entry for entry in found if entry.kind != "status"]


def test_what_waited_through_an_outage_comes_in_order_with_the_time_at_which_it_was_said(
    outbox: Outbox, outage: Outage, claim: Claim
) -> None:
    outbox.put(Hello(pid=7))
    for step in range(200):
        outbox.put(Measured(step=step, values={"reward": float(step)}))
        outbox.put(Advanced(step=step, total=200))
        outbox.put(f"line {step}")
    said_by = utc_now()
    outage.is_over = True
    assert outbox.close(30)
    events, lines = read(claim, "events"), read(claim, "logs")
    assert [event.data["step"] for event in events if event.kind == "metrics"] == list(range(200))
    assert [event.kind for event in events] == ["phase", *["metrics", "progress"] * 200]
    assert [line.data["text"] for line in lines] == [f"line {step}" for step in range(200)]
    assert max(entry.time for entry in (*events, *lines)) <= said_by
    assert claim.store.get(claim.job_id).progress.step == 199
    # 401 entries were said: far fewer writes than that, and none that would take long.
    counts = [count for channel, count in outage.writes if channel == "events"]
    assert sum(counts) == 401
    assert max(counts) <= 100
    assert len(counts) < 20


def test_a_phase_is_part_of_the_progress_and_keeps_its_numbers(claim: Claim, tmp_path: Path) -> None:
    before = Progress(step=5, total=10, metrics={"reward": 1.0}, phase="drawing")
    outbox = Outbox(claim, tmp_path, keep_checkpoints=1, progress=before)
    for said in (
        PhaseBegan(phase="preparing"),
        PhaseBegan(phase="training"),
        Advanced(step=7, total=10),
        PhaseBegan(phase="drawing"),
    ):
        outbox.put(said)
    assert outbox.close(30)
    told = [(event.data["phase"], event.data["step"], event.data["total"]) for event in read(claim, "events")]
    assert told == [("preparing", 5, 10), ("training", 5, 10), ("training", 7, 10), ("drawing", 7, 10)]
    assert claim.store.get(claim.job_id).progress == Progress(step=7, total=10, phase="drawing")


def test_what_is_measured_after_the_last_step_is_among_the_newest_metrics(
    outbox: Outbox, claim: Claim
) -> None:
    outbox.put(Measured(step=5, values={"reward": 1.0}))
    outbox.put(Advanced(step=5, total=5))
    outbox.put(PhaseBegan(phase="testing"))
    outbox.put(Measured(step=5, values={"battery/passed": 0.0}))
    assert outbox.close(30)
    metrics = {"reward": 1.0, "battery/passed": 0.0}
    assert claim.store.get(claim.job_id).progress == Progress(
        step=5, total=5, metrics=metrics, phase="testing"
    )


def test_what_is_said_before_a_file_is_stored_before_it(outbox: Outbox, claim: Claim, tmp_path: Path) -> None:
    outbox.put(Started(device="cpu", engine="native"))
    for step in (10, 20):
        outbox.put(Measured(step=step, values={"reward": 1.0}))
        outbox.put(PhaseEnded(name="evaluation", seconds=0.5))
        name = f"checkpoint-{step}"
        (tmp_path / name).write_bytes(b"state")
        outbox.put(FileReady(name=name, path=name, role="checkpoint", media_type="", step=step))
    outbox.put(Noted(text="The end."))
    assert outbox.close(30)
    events = read(claim, "events")
    assert [entry.kind for entry in events] == [
        *("metrics", "phase", "artifact"),
        *("metrics", "phase", "artifact"),
        "note",
    ]
    assert all(0 < entry.data["upload_s"] < 30 for entry in events if entry.kind == "artifact")
    assert claim.store.get(claim.job_id).newest("metrics") is None  # M3: it is written at the end.


def test_of_one_name_the_newest_is_kept_and_what_it_replaced_is_removed_after_a_while(
    outbox: Outbox, outage: Outage, claim: Claim, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("worker.supervision.outbox._DELETE_AFTER_S", -1.0)
    for step in (1, 2, 3):
        path = tmp_path / f"{step}-policy.npz"
        path.write_bytes(b"policy %d" % step)
        outbox.put(FileReady(name="policy.npz", path=path.name, role="export", media_type="", step=step))
    outage.is_over = True
    assert outbox.close(30)
    [kept] = claim.store.get(claim.job_id).artifacts
    assert (kept.step, claim.objects.get(kept.key)) == (3, b"policy 3")
    # The second is dropped last, so it waits for a next file or the collection of orphans.
    assert {claim.objects.get(one.key) for one in claim.objects.list("")} == {b"policy 2", b"policy 3"}
    assert list(tmp_path.iterdir()) == []


def test_a_wait_for_the_stores_can_be_called_off(outbox: Outbox, outage: Outage) -> None:
    outbox.put("a line")
    leaving = threading.Event()
    threading.Timer(0.2, leaving.set).start()
    began = time.monotonic()
    assert not outbox.close(A_DAY_S, leaving.is_set)
    assert 0.2 <= time.monotonic() - began < 3
    outage.is_over = True
    assert outbox.close(30)


def test_an_abandoned_outbox_waits_no_longer(outbox: Outbox, outage: Outage) -> None:
    outbox.put("a line")
    assert not outbox.close(0.2)
    outbox.abandon()
    wait_until(lambda: "outbox" not in {thread.name for thread in threading.enumerate()})
    assert outage.writes == []


def test_h6a_a_training_that_was_taken_over_publishes_and_removes_no_file_but_its_own(
    outbox: Outbox, claim: Claim, tmp_path: Path
) -> None:
    """As the audit's outbox_reads_anything.py does it, with absolute paths and links."""
    spool, secret = tmp_path, tmp_path.parent / "keys.json"
    secret.write_text("TOP SECRET")
    (spool / "link").symlink_to(secret)
    (spool / "own").write_bytes(b"own")
    for path in (str(secret), f"../{secret.name}", "link", "own"):
        outbox.put(FileReady(name=f"named-{path[-3:]}", path=path, role="log", media_type=""))
    assert outbox.close(30)
    (kept,) = claim.store.get(claim.job_id).artifacts
    assert claim.objects.get(kept.key) == b"own"
    notes = [entry.data["text"] for entry in read(claim, "events") if entry.kind == "note"]
    assert len(notes) == 3
    assert all("is no plain file" in note for note in notes)
    assert secret.exists()


def test_the_memory_that_a_training_has_taken_is_in_its_attempt(outbox: Outbox, claim: Claim) -> None:
    for num_bytes in (2**20, 2**21):
        outbox.put(MemoryPeak(bytes=num_bytes))
    assert outbox.close(30)
    assert claim.store.get(claim.job_id).attempts[-1].peak_bytes == 2**21
