"""The file of all metrics, which a supervisor writes from the feed when an attempt ends."""

import json
import tempfile
import tracemalloc
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.jobs import feeds
from core.jobs.attempts import Claim
from core.jobs.job import utc_now
from core.jobs.metrics import Block, Measurement
from core.jobs.store import Entry
from core.reasons import Reason
from core.retry import CalledOff
from tests.faults.bench import wait_until
from tests.in_memory import MemoryObjectStore
from tests.unit.jobs.playing import PlayedWorker
from worker.protocol import Measured as MeasuredMessage
from worker.supervision.measurements import store_metrics
from worker.supervision.outbox import Outbox

NAMES = [f"training/{number}" for number in range(30)]


@pytest.fixture
def file(tmp_path: Path) -> Iterator[IO[bytes]]:
    with tempfile.NamedTemporaryFile(dir=tmp_path) as file:
        yield file


def stored(claim: Claim, file: IO[bytes]) -> list[tuple[int, dict[str, Any]]]:
    """Steps and values of the file."""
    assert store_metrics(claim, file, Path(file.name), 1, bool)
    artifact = claim.store.get(claim.job_id).newest("metrics")
    assert artifact is not None
    body = claim.objects.get(artifact.key)
    assert len(body) == artifact.size
    return [(row["step"], row["values"]) for row in map(json.loads, body.splitlines())]


def measure(claim: Claim, *rows: tuple[int, dict[str, float]]) -> None:
    entries = [
        Entry(kind="metrics", time=utc_now(), data={"step": step, "values": values}) for step, values in rows
    ]
    claim.store.record(claim.job_id, claim.token, "events", entries, write_id=str(rows))


def test_a_later_attempt_takes_the_place_of_what_it_measured_again_and_drops_nothing_else(
    job_store: PostgresJobStore, file: IO[bytes]
) -> None:
    """M3."""
    worker = PlayedWorker(job_store, MemoryObjectStore())
    job = worker.submit()
    first = worker.begin(job)
    measure(first, (1, {"a": 1.0}), (2, {"a": 2.0}), (2, {"eval": 2.0}), (3, {"a": 3.0}), (4, {"odd": 4.0}))
    first.give_back(Reason.WORKER_DRAINED, "")
    second = worker.begin(job)
    measure(second, (2, {"eval": 20.0}), (3, {"a": 30.0}), (5, {"a": 50.0}))
    second.give_back(Reason.WORKER_DRAINED, "")
    third = worker.begin(job)
    measure(third, (5, {"a": 500.0}), (6, {"a": 600.0}))
    assert stored(third, file) == [
        (1, {"a": 1.0}),
        (2, {"a": 2.0}),
        (4, {"odd": 4.0}),
        (2, {"eval": 20.0}),
        (3, {"a": 30.0}),
        (5, {"a": 500.0}),
        (6, {"a": 600.0}),
    ]
    assert stored(third, file)[-1] == (6, {"a": 600.0})  # As after an answer that was lost.


def test_without_rows_there_is_no_file_and_a_drain_ends_the_writing(
    job_store: PostgresJobStore, file: IO[bytes]
) -> None:
    worker = PlayedWorker(job_store, MemoryObjectStore())
    claim = worker.begin(worker.submit())
    assert not store_metrics(claim, file, Path(file.name), 1, bool)
    assert claim.store.get(claim.job_id).newest("metrics") is None
    with pytest.raises(CalledOff):
        store_metrics(claim, file, Path(file.name), 1, lambda: True)


def block_of(steps: Sequence[int], first: int) -> Block:
    return Block.of(
        Measurement(number, step, float(step), dict.fromkeys(NAMES, float(step)))
        for number, step in enumerate(steps, first)
    )


@pytest.mark.extra
def test_the_memory_that_the_file_takes_does_not_grow_with_the_rows(
    job_store: PostgresJobStore, file: IO[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """M3: 2.9 kB a row were kept, 7.6 GB for a month. The second attempt measures the last rows again."""
    worker = PlayedWorker(job_store, MemoryObjectStore())
    job = worker.submit()
    worker.begin(job).give_back(Reason.WORKER_DRAINED, "")
    claim = worker.begin(job)
    monkeypatch.setattr(claim.objects, "put_file", lambda *_, **__: None)
    peaks: list[int] = []
    for number in (2_000, 10_000):
        steps = [*range(number), *range(number - 600, number)]

        def parts(job_id: str, *, steps: Sequence[int] = steps, **_: Any) -> Iterator[tuple[Block, int]]:
            for at in range(0, len(steps), 1000):
                yield block_of(steps[at : at + 1000], at + 1), at + 1000

        monkeypatch.setattr(feeds, "read_metrics", parts)
        tracemalloc.start()
        assert store_metrics(claim, file, Path(file.name), 1, bool)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        file.seek(0)
        assert sum(1 for _ in file) == number
    assert peaks[1] < 1.2 * peaks[0]


def test_a_supervisor_keeps_no_row_that_is_stored(
    job_store: PostgresJobStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """M3."""
    worker = PlayedWorker(job_store, MemoryObjectStore())
    claim = worker.begin(worker.submit())
    count = 0

    def record(job_id: str, token: str, channel: str, entries: list[Entry], *_: Any, **__: Any) -> None:
        nonlocal count
        count += len(entries)

    monkeypatch.setattr(claim.store, "record", record)
    outbox = Outbox(claim, tmp_path, 1)
    held: list[int] = []
    tracemalloc.start()
    for most in (1_000, 4_000):
        while count < most:
            for step in range(500):
                outbox.put(MeasuredMessage(step=step, values=dict.fromkeys(NAMES, 1.0)))
            wait_until(lambda: outbox.num_waiting == 0)
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert outbox.close(30)
    assert held[1] - held[0] < 1_000_000  # 3,000 rows had 8.7 MB.
