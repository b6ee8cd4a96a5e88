"""The columns of finished parts of a feed: made beside them, and done without when they are lost."""

from collections.abc import Mapping
from typing import Any

import pytest
from structlog.testing import capture_logs

from core.adapters.memory.objects import MemoryObjectStore
from core.adapters.postgres.store import PostgresJobStore
from core.errors import StorageUnavailable
from core.jobs import columns, feeds
from core.jobs.columns import GROUP
from core.jobs.curves import Curves
from core.jobs.ending import delete
from core.jobs.status import JobStatus
from core.jobs.store import Chunk, Entry
from core.reasons import Reason
from core.storage import keys
from core.storage.objects import ObjectStore
from tests.unit.jobs.making import NOON
from tests.unit.jobs.playing import PlayedWorker

PER_CHUNK = 3


class Run:
    """A run whose events lie in as many chunks as they give, over both stores."""

    def __init__(self, store: PostgresJobStore, objects: ObjectStore) -> None:
        self.store, self.objects = store, objects
        self.worker = PlayedWorker(store, objects)
        self.claim = self.worker.begin(self.worker.submit())
        self.id = self.claim.job_id
        self._writes = 0

    def measure(self, *steps: int) -> None:
        self._writes += 1
        entries = [
            Entry(
                kind="metrics", time=NOON, data={"step": step, "values": {"a": self._writes + step, "b": 0.5}}
            )
            for step in steps
        ]
        self.store.record(self.id, self.claim.token, "events", entries, write_id=str(self._writes))

    def measure_chunks(self, count: int) -> None:
        """As many steps as fill these chunks; the first also has the two statuses of the job's begin."""
        self.measure(*range(PER_CHUNK * count - 2))

    def compact(self) -> None:
        while feeds.compact(store=self.store, objects=self.objects):
            pass

    def chunks(self) -> list[Chunk]:
        return [chunk for chunk in self.store.chunks([self.id])[self.id] if chunk.channel == "events"]

    def columns(self) -> list[str]:
        """The keys of the columns that the bucket has."""
        return [info.key for info in self.objects.list(f"{keys.job(self.id)}columns/")]

    def in_columns(self, names: frozenset[str] | None = None) -> list[tuple[Curves, int]]:
        return list(columns.read(self.id, names, store=self.store, objects=self.objects))

    def drawn(self) -> Mapping[str, Any]:
        """The curves as the API reads them: from columns, and behind these from lines."""
        curves, parts = Curves(), self.in_columns()
        for part, _ in parts:
            curves.extend(part)
        return self._with_lines(curves, parts[-1][1] if parts else 0)

    def by_lines(self) -> Mapping[str, Any]:
        return self._with_lines(Curves(), 0)

    def _with_lines(self, curves: Curves, last: int) -> Mapping[str, Any]:
        is_end = False
        while not is_end:
            page = feeds.read_metrics(self.id, last, 1000, store=self.store, objects=self.objects)
            curves.add(page.measured)
            last, is_end = page.last, page.is_end
        return curves


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every entry is due."""
    monkeypatch.setattr(feeds, "MAX_BYTES", 1)
    monkeypatch.setattr(feeds, "_MAX_ENTRIES", PER_CHUNK)


@pytest.fixture
def run(job_store: PostgresJobStore) -> Run:
    return Run(job_store, MemoryObjectStore())


def test_each_eight_chunks_have_columns_with_the_same_metrics(
    job_store: PostgresJobStore, objects: ObjectStore
) -> None:
    run = Run(job_store, objects)
    run.measure_chunks(2 * GROUP + 3)
    run.compact()
    chunks = run.chunks()
    assert len(chunks) == 2 * GROUP + 3
    assert [last for _, last in run.in_columns()] == [chunks[GROUP - 1].last, chunks[2 * GROUP - 1].last]
    assert run.drawn() == run.by_lines()
    assert [set(curves) for curves, _ in run.in_columns(frozenset("a"))] == [{"a"}, {"a"}]


def test_what_an_attempt_measured_beyond_its_checkpoint_vanishes_across_groups(run: Run) -> None:
    run.measure(*range(40))
    run.measure(*range(10, 60))  # Begins within the first group, and is measured into the third.
    run.compact()
    assert len(run.columns()) == 3
    steps, values = run.drawn()["a"].steps, run.drawn()["a"].values
    assert list(steps) == list(range(60))
    assert list(values) == [float(step + (1 if step < 10 else 2)) for step in range(60)]
    assert run.drawn() == run.by_lines()


@pytest.mark.parametrize("lost", [0, 1])
def test_lost_columns_are_told_and_the_lines_are_read(run: Run, lost: int) -> None:
    run.measure_chunks(3 * GROUP)
    run.compact()
    before = run.by_lines()
    run.objects.delete_prefix(run.columns()[lost])
    with capture_logs() as said:
        assert len(run.in_columns()) == lost
    assert [line["event"] for line in said] == ["columns_missing"]
    assert run.drawn() == before


def test_damaged_columns_are_told_and_the_lines_are_read(run: Run) -> None:
    run.measure_chunks(GROUP)
    run.compact()
    before = run.by_lines()
    [key] = run.columns()
    run.objects.put(key, run.objects.get(key)[:-1] + b"!")
    with capture_logs() as said:
        assert run.in_columns() == []
    assert [line["event"] for line in said] == ["columns_damaged"]
    assert run.drawn() == before


def test_columns_are_of_the_chunks_that_the_record_names_or_not_read(run: Run) -> None:
    run.measure_chunks(GROUP)
    run.compact()
    first = run.chunks()[0]
    feeds.close_gap(run.id, first, store=run.store, objects=run.objects)
    assert run.in_columns() == []
    assert run.drawn() == run.by_lines()
    assert list(run.drawn()["a"].steps) == list(range(1, PER_CHUNK * GROUP - 2))


def test_curves_survive_the_loss_of_the_lines(run: Run) -> None:
    run.measure_chunks(GROUP)
    run.compact()
    before = run.by_lines()
    run.objects.delete_prefix(f"{keys.job(run.id)}events/")
    assert run.drawn() == before


@pytest.mark.parametrize("is_lost", [True, False])
def test_a_group_with_a_chunk_that_is_lost_or_damaged_gets_no_columns(run: Run, *, is_lost: bool) -> None:
    run.measure_chunks(GROUP - 1)
    run.compact()
    second = run.chunks()[1]
    if is_lost:
        run.objects.delete_prefix(second.key)
    else:
        run.objects.put(second.key, b"{}")
    run.measure(*range(100, 100 + PER_CHUNK * (GROUP + 1)))
    with capture_logs() as said:
        run.compact()
    assert [line["event"] for line in said] == ["feed_lost" if is_lost else "feed_damaged"]
    assert len(run.chunks()) == 2 * GROUP  # The feed is moved all the same.
    [key] = run.columns()
    assert key == columns.key(run.id, run.chunks()[GROUP:])


@pytest.mark.parametrize("data", [{}, {"step": 10**30, "values": {"a": 1.0}}])
def test_a_group_with_metrics_that_nobody_can_read_gets_no_columns(run: Run, data: dict[str, Any]) -> None:
    entry = Entry(kind="metrics", time=NOON, data=data)
    run.store.record(run.id, run.claim.token, "events", [entry], write_id="w")
    run.measure(*range(PER_CHUNK * (GROUP - 1)))
    with capture_logs() as said:
        run.compact()
    assert [line["event"] for line in said] == ["metrics_unreadable"]
    assert (len(run.chunks()), run.columns()) == (GROUP, [])


def test_columns_that_could_not_be_stored_are_stored_at_the_next_pass(run: Run) -> None:
    put = run.objects.put

    def refuse(key: str, body: bytes, **said: Any) -> None:
        if "/columns/" in key:
            raise StorageUnavailable("away")
        put(key, body, **said)

    run.objects.put = refuse  # type: ignore[method-assign]
    run.measure_chunks(GROUP)
    with pytest.raises(StorageUnavailable):
        run.compact()
    assert len(run.chunks()) == GROUP - 1
    run.objects.put = put  # type: ignore[method-assign]
    run.compact()
    assert (len(run.chunks()), len(run.columns())) == (GROUP, 1)
    assert run.drawn() == run.by_lines()


def test_a_deleted_job_leaves_no_columns(run: Run) -> None:
    run.measure_chunks(GROUP)
    run.compact()
    assert run.columns()
    run.claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    delete(run.id, store=run.store, objects=run.objects)
    assert list(run.objects.list("")) == []
    assert run.in_columns() == []


def test_logs_have_no_columns(run: Run) -> None:
    run.worker.say(run.claim, "logs", *map(str, range(PER_CHUNK * GROUP)))
    run.compact()
    assert run.columns() == []


def test_a_group_with_very_many_names_gets_no_columns_and_its_feed_is_moved(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """H3: the names of an import of 3.6 MB took the reconciler 1.3 GB, again after each restart."""
    monkeypatch.setattr(columns, "MOST_METRICS", 1)
    run.measure_chunks(GROUP)
    with capture_logs() as said:
        run.compact()
    assert [line["event"] for line in said] == ["columns_skipped"]
    assert len(run.chunks()) == GROUP
    assert run.columns() == []
    assert set(run.drawn()) == {"a", "b"}


def test_chunks_are_made_by_bytes_too(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """H3: 2,000 wide rows were one object of 250 MB."""
    monkeypatch.setattr(feeds, "_MAX_ENTRIES", 1000)
    monkeypatch.setattr(feeds, "_MAX_CHUNK_BYTES", 200)
    run.measure(*range(100))
    before = run.by_lines()
    run.compact()
    assert len(run.chunks()) > 10
    assert run.by_lines() == before
    assert list(before["b"].steps) == list(range(100))
