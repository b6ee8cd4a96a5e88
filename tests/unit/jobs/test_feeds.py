"""Feeds read across the record and the object store, and moved from the one to the other."""

import json
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from typing import Any

import psycopg
import pytest
from msgspec.structs import replace

from core.adapters.postgres.store import PostgresJobStore
from core.errors import JobNotFound, StorageUnavailable
from core.jobs import feeds
from core.jobs.attempts import Claim
from core.jobs.ending import delete
from core.jobs.job import new_job_id
from core.jobs.status import JobStatus
from core.jobs.store import Channel, Entry
from core.reasons import Reason
from core.storage import keys
from core.storage.objects import ObjectStore
from tests.feeds import read_feed
from tests.in_memory import MemoryObjectStore
from tests.unit.jobs.making import NOON
from tests.unit.jobs.playing import PlayedWorker


class Feed:
    """The feeds of one running job, over both stores."""

    def __init__(self, store: PostgresJobStore, objects: ObjectStore) -> None:
        self.store, self.objects = store, objects
        self.worker = PlayedWorker(store, objects)
        self.claim: Claim = self.worker.begin(self.worker.submit())
        self.id = self.claim.job_id

    def say(self, *texts: str) -> None:
        self.worker.say(self.claim, "logs", *texts)

    def append(self, *entries: Entry, write_id: str = "w") -> None:
        self.store.record(self.id, self.claim.token, "events", entries, write_id=write_id)

    def read(self, channel: Channel = "logs", **asked: Any) -> Sequence[Entry]:
        return read_feed(self.id, channel, store=self.store, objects=self.objects, **asked)

    def texts(self, **asked: Any) -> list[str]:
        return [entry.data["text"] for entry in self.read(**asked)]

    def metrics(self, after: int = 0) -> list[tuple[int, float, int, Any]]:
        """All that `read_metrics` gives: numbers, times, steps and values."""
        parts = feeds.read_metrics(self.id, store=self.store, objects=self.objects, after=after)
        return [(row.number, row.time, row.step, row.values) for block, _ in parts for row in block.rows()]

    def compact(self) -> int:
        return feeds.compact(store=self.store, objects=self.objects)

    def chunks(self, channel: Channel = "logs") -> list[str]:
        """The keys of their objects."""
        return [found.key for found in self.objects.list(f"{keys.job(self.id)}{channel}/")]


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every entry is due, three to a chunk, and every block of metrics is a chunk."""
    monkeypatch.setattr(feeds, "MAX_BYTES", 1)
    monkeypatch.setattr(feeds, "MAX_METRICS_BYTES", 1)
    monkeypatch.setattr(feeds, "_MAX_ENTRIES", 3)
    monkeypatch.setattr(feeds, "_MAX_VALUES", 4)  # A page ends within a chunk.


@pytest.fixture
def feed(job_store: PostgresJobStore, objects: ObjectStore) -> Feed:
    return Feed(job_store, objects)


@pytest.mark.usefixtures("at_once")
class TestReading:
    def test_what_lies_in_chunks_reads_as_what_does_not(self, feed: Feed) -> None:
        said = [f"{i} é\n\u2028\0🐜\r" for i in range(8)]
        feed.say(*said)
        before = feed.read()
        assert feed.compact() == 2  # The logs, and the word of two statuses in the events.
        assert len(feed.chunks()) == 1
        assert feed.read() == before
        while feed.compact():
            pass
        assert len(feed.chunks()) == 3
        assert feed.store.feed(feed.id, "logs").entries == []
        assert feed.read() == before
        assert feed.texts() == said

    def test_every_place_to_resume_at_gives_the_rest(self, feed: Feed) -> None:
        # Two chunks of three, and two entries behind them.
        feed.say(*map(str, range(8)))
        feed.compact()
        feed.compact()
        for after in range(10):
            for limit in (1, 2, 3, 5, 100):
                assert feed.texts(after=after, limit=limit) == [
                    str(i) for i in range(after, min(8, after + limit))
                ]

    def test_more_chunks_than_one_look_gives_are_all_read(self, feed: Feed) -> None:
        feed.say(*map(str, range(40)))
        while feed.compact():
            pass
        assert len(feed.chunks()) == 14
        assert feed.texts() == [str(i) for i in range(40)]
        assert feed.texts(after=37) == ["37", "38", "39"]

    def test_metrics_and_other_events_are_read_in_their_order_wherever_they_lie(self, feed: Feed) -> None:
        at = datetime(2026, 11, 26, 15, 38, 53, 123457, tzinfo=UTC)
        measured = {"step": 2**53 - 1, "values": {"a/\u2028 é": 0.1, "whole": 3.0, "b": None}}
        entries = [
            Entry(kind="metrics", time=at, data=measured) if i % 3 else Entry(kind="note", time=NOON)
            for i in range(40)
        ]
        for part in range(8):
            feed.append(*entries[5 * part : 5 * part + 5], write_id=str(part))
        said = feed.read("events")
        assert [replace(entry, id="") for entry in said[2:]] == entries
        rows = [
            (int(one.id), one.time.timestamp(), one.data["step"], one.data["values"])
            for one in said
            if one.kind == "metrics"
        ]
        is_left = True
        while is_left:
            for after in (0, 1, 7, 30, 41, 42, 50):
                assert feed.metrics(after) == [row for row in rows if row[0] > after]
                for limit in (1, 2, 5, 100):
                    assert feed.read("events", after=after, limit=limit) == said[after : after + limit]
                    assert feed.read("events", after=after, at_once=limit) == said[after:]
            is_left = feed.compact() > 0
        assert (len(feed.chunks("events")), len(feed.chunks("metrics"))) == (6, 8)

    def test_a_note_stands_for_a_chunk_of_metrics_that_is_lost(self, feed: Feed) -> None:
        row, note = (
            Entry(kind="metrics", time=NOON, data={"step": 1, "values": {"a": 1.0}}),
            Entry(kind="note", time=NOON),
        )
        feed.append(row, note, row, write_id="1")
        feed.append(row, write_id="2")
        while feed.compact():
            pass
        [lost, _] = [one for one in feed.store.chunks([feed.id])[feed.id] if one.channel == "metrics"]
        feed.objects.delete_prefix(lost.key)
        for _ in range(2):
            assert [entry.kind for entry in feed.read("events")[2:]] == ["note", "note", "metrics"]
            text = "The metrics from entry 3 to entry 5 of this feed were lost from the object store."
            assert feed.read("events", after=4)[0].data == {"text": text}
            assert [number for number, *_ in feed.metrics()] == [6]
            feeds.close_gap(feed.id, lost, store=feed.store, objects=feed.objects)

    def test_an_empty_feed_is_empty_and_an_unknown_jobs_is_not_found(self, feed: Feed) -> None:
        assert feed.read() == []
        with pytest.raises(JobNotFound):
            read_feed(new_job_id(NOON), "logs", store=feed.store, objects=feed.objects)

    def test_a_note_stands_for_a_chunk_whose_object_is_lost(self, feed: Feed) -> None:
        feed.say(*"abcd")
        feed.compact()
        feed.objects.delete_prefix(feed.chunks()[0])
        assert feed.texts() == ["Entries 1 to 3 of this feed were lost from the object store.", "d"]
        assert feed.texts(after=3) == ["d"]


@pytest.mark.usefixtures("at_once")
class TestCompacting:
    def test_chunks_hold_entries_by_the_line_under_a_key_with_their_hash(self, feed: Feed) -> None:
        feed.say("a", "b")
        feed.compact()
        (key,) = feed.chunks()
        documents = [json.loads(line) for line in feed.objects.get(key).splitlines()]
        assert [(each["id"], each["data"]) for each in documents] == [
            ("1", {"text": "a"}),
            ("2", {"text": "b"}),
        ]
        (chunk,) = feed.store.feed(feed.id, "logs").chunks
        assert (chunk.key, chunk.first, chunk.last) == (key, 1, 2)
        assert key == keys.chunk(feed.id, "logs", 1, chunk.sha256)
        assert chunk.size == len(feed.objects.get(key))

    def test_nothing_due_makes_nothing(self, feed: Feed) -> None:
        feed.compact()
        assert feed.compact() == 0

    def test_what_is_said_while_a_chunk_is_made_stays(self, feed: Feed) -> None:
        feed.say("a")
        interrupt(feed, lambda: feed.say("b"))
        feed.compact()
        assert feed.texts() == ["a", "b"]

    def test_a_store_that_is_away_loses_nothing_and_the_next_look_goes_on(self, feed: Feed) -> None:
        def fail() -> None:
            raise StorageUnavailable("away")

        feed.say("a")
        interrupt(feed, fail)
        with pytest.raises(StorageUnavailable):
            feed.compact()
        assert feed.texts() == ["a"]
        feed.compact()
        assert (feed.texts(), len(feed.chunks())) == (["a"], 1)

    def test_a_job_deleted_while_its_chunk_is_made_keeps_no_other_from_theirs(self, feed: Feed) -> None:
        feed.say("a")
        job = feed.claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
        other = Feed(feed.store, feed.objects)
        other.say("b")
        interrupt(feed, lambda: delete(job.id, store=feed.store, objects=feed.objects))
        feed.compact()
        assert (other.texts(), len(other.chunks())) == (["b"], 1)
        with pytest.raises(JobNotFound):
            feed.read()

    def test_two_that_compact_at_once_make_each_chunk_once(self, feed: Feed) -> None:
        feed.say(*map(str, range(30)))
        together = threading.Barrier(2)

        def compact_all() -> None:
            together.wait()
            while feed.compact():
                pass

        with ThreadPoolExecutor(2) as pool:
            for done in [pool.submit(compact_all) for _ in range(2)]:
                done.result(60)
        assert feed.texts() == [str(i) for i in range(30)]
        chunks = [
            chunk
            for after in range(0, 30, 3)
            for chunk in feed.store.feed(feed.id, "logs", after=after).chunks
        ]
        assert {(chunk.first, chunk.last) for chunk in chunks} == {(i, i + 2) for i in range(1, 30, 3)}

    def test_a_reader_sees_no_gap_and_no_double_meanwhile(self, feed: Feed) -> None:
        most, done = 150, threading.Event()

        def write() -> None:
            for i in range(0, most, 2):
                feed.say(str(i), str(i + 1))
            done.set()

        def compact() -> None:
            while not done.is_set():
                feed.compact()

        def read() -> int:
            looks = 0
            while not done.is_set():
                texts = feed.texts()
                assert texts == [str(i) for i in range(len(texts))]
                looks += 1
            return looks

        with ThreadPoolExecutor(3) as pool:
            tasks = [pool.submit(write), pool.submit(compact)]
            assert pool.submit(read).result(60) > 0
            for task in tasks:
                task.result(60)
        assert feed.texts() == [str(i) for i in range(most)]
        assert len(feed.chunks()) > 1


def test_a_feed_waits_for_its_size_its_age_or_its_jobs_end(
    job_store: PostgresJobStore, database_url: str
) -> None:
    objects = MemoryObjectStore()
    short, long, old, ended = (Feed(job_store, objects) for _ in range(4))
    for feed in (short, ended):
        feed.say("a")
    long.say("x" * feeds.MAX_BYTES)
    old.append(Entry(kind="note", time=datetime.now(UTC)))
    with psycopg.connect(database_url, autocommit=True) as database:
        earlier = "UPDATE entries SET stored_at = stored_at - %s WHERE job_id = %s"
        database.execute(earlier, (feeds.MAX_AGE, old.id))
    ended.claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    feeds.compact(store=job_store, objects=objects)
    made = [
        [channel for channel in ("events", "logs") if each.chunks(channel)]
        for each in (short, long, old, ended)
    ]
    assert made == [[], ["logs"], ["events"], ["events", "logs"]]


@pytest.mark.parametrize("behind", [timedelta(minutes=11), timedelta(minutes=-11)])
def test_the_clock_of_a_worker_does_not_decide_about_chunks(
    job_store: PostgresJobStore, behind: timedelta
) -> None:
    """M9: eleven minutes behind, each look made a chunk of what had come since."""
    feed = Feed(job_store, MemoryObjectStore())
    for number in range(3):
        feed.append(Entry(kind="note", time=datetime.now(UTC) - behind), write_id=str(number))
        assert feed.compact() == 0
    assert feed.chunks("events") == []


def interrupt(feed: Feed, meanwhile: Any) -> None:
    """Let something happen at the next put: after a chunk's entries were read, before the chunk is named."""
    put = feed.objects.put

    def once(*args: Any, **said: Any) -> None:
        feed.objects.put = put  # type: ignore[method-assign]
        meanwhile()
        put(*args, **said)

    feed.objects.put = once  # type: ignore[method-assign]
