"""What the record promises of feeds: numbered entries, whose older part lies in chunks."""

import secrets
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from functools import partial
from typing import Any

import psycopg
import pytest

from core.errors import JobNotFound, LeaseLost, Rejected
from core.jobs.job import Job, Progress, new_job_id
from core.jobs.metrics import Block
from core.jobs.status import JobStatus
from core.jobs.store import Chunk, Entry, JobQuery, JobStore, Mark, MetricsPart, entry_number
from core.reasons import Reason
from tests.contract.recording import (
    LEASE,
    NOW,
    Database,
    at_once,
    chunk_of,
    held,
    line,
    queued_job,
    say,
    taken_back,
    texts,
)

AN_HOUR = timedelta(hours=1)


@pytest.fixture
def job(jobs: JobStore) -> Job:
    """A job that an attempt holds."""
    return held(jobs, queued_job())


def logs(jobs: JobStore, job: Job, after: int = 0) -> list[str]:
    return texts(jobs.feed(job.id, "logs", after=after).entries)


def compact(jobs: JobStore, job: Job, count: int) -> Chunk:
    """Move the oldest lines into a chunk."""
    chunk = chunk_of(jobs.oldest_entries(job.id, "logs", limit=count))
    jobs.replace_by_chunk(job.id, chunk)
    return chunk


class TestEntries:
    def test_entries_come_back_in_order_and_numbered_from_one(self, jobs: JobStore, job: Job) -> None:
        say(jobs, job, "a", "é\n\0🐜")
        say(jobs, job, "c")
        entries = jobs.feed(job.id, "logs").entries
        assert texts(entries) == ["a", "é\n\0🐜", "c"]
        assert [entry.id for entry in entries] == ["1", "2", "3"]
        assert (entries[0].kind, entries[0].time) == ("line", NOW)

    def test_values_that_are_not_finite_become_null(self, jobs: JobStore, job: Job) -> None:
        entry = Entry(
            kind="metrics", time=NOW, data={"step": 1, "values": {"loss": float("nan"), "reward": 1.5}}
        )
        note = Entry(kind="note", time=NOW, data={"loss": float("inf")})
        jobs.record(job.id, job.token, "events", [entry, note], write_id="w")
        *_, measured, noted = jobs.feed(job.id, "events").entries
        data = {"step": 1, "values": {"loss": None, "reward": 1.5}}
        assert measured == Entry(id="2", kind="metrics", time=NOW, data=data)
        assert noted.data == {"loss": None}

    def test_reading_resumes_after_a_number(self, jobs: JobStore, job: Job) -> None:
        say(jobs, job, *map(str, range(25)))
        got: list[str] = []
        after = 0
        while entries := jobs.feed(job.id, "logs", after=after, limit=10).entries:
            assert len(entries) <= 10
            got += texts(entries)
            after = int(entries[-1].id)
        assert got == [str(i) for i in range(25)]
        assert after == 25

    def test_channels_are_apart(self, jobs: JobStore, job: Job) -> None:
        say(jobs, job, "a")
        assert [entry.kind for entry in jobs.feed(job.id, "events").entries] == ["status"]
        assert jobs.feed(job.id, "events").entries[0].id == jobs.feed(job.id, "logs").entries[0].id == "1"

    def test_a_new_job_has_an_empty_feed(self, jobs: JobStore) -> None:
        new = queued_job()
        jobs.add(new)
        part = jobs.feed(new.id, "events")
        assert (list(part.chunks), list(part.entries)) == ([], [])

    def test_the_feed_of_an_unknown_job_is_not_found(self, jobs: JobStore) -> None:
        with pytest.raises(JobNotFound):
            jobs.feed(new_job_id(NOW), "events")

    @pytest.mark.parametrize("after", ["x", "-1", "1-0", " 1", "1.0", "٣", "9" * 40, "\0"])
    def test_an_id_of_nowhere_is_refused(self, after: str) -> None:
        with pytest.raises(Rejected, match="is not the id of an entry"):
            entry_number(after)

    @pytest.mark.parametrize(("after", "number"), [("", 0), ("0", 0), ("17", 17), ("9" * 18, 10**18 - 1)])
    def test_an_id_is_a_number_that_can_be_asked_for(
        self, jobs: JobStore, job: Job, after: str, number: int
    ) -> None:
        assert entry_number(after) == number
        assert len(jobs.feed(job.id, "events", after=number).entries) == (number == 0)

    def test_writers_at_the_same_moment_are_numbered_without_gap(self, jobs: JobStore, job: Job) -> None:
        assert all(at_once([partial(say, jobs, job, str(i), str(i)) for i in range(8)], LeaseLost))
        entries = jobs.feed(job.id, "logs").entries
        assert [entry.id for entry in entries] == [str(i) for i in range(1, 17)]
        # What is written at once stays together.
        assert texts(entries)[::2] == texts(entries)[1::2]

    def test_word_of_a_status_comes_between_an_attempts_own(self, jobs: JobStore, job: Job) -> None:
        note = Entry(kind="note", time=NOW, data={})
        jobs.record(job.id, job.token, "events", [note, note], write_id="1")
        jobs.save(job.running())
        jobs.record(job.id, job.token, "events", [note], write_id="2")
        kinds = [entry.kind for entry in jobs.feed(job.id, "events").entries]
        assert kinds == ["status", "note", "note", "status", "note"]


class TestProgress:
    def test_progress_is_read_with_the_job_and_survives_saves(self, jobs: JobStore, job: Job) -> None:
        progress = Progress(step=10, total=100, steps_per_second=5.0, metrics={"episode_reward": 1.5})
        jobs.record(job.id, job.token, "events", [], progress, write_id="w")
        jobs.save(job.running(device="cpu"))
        assert jobs.get(job.id).progress == progress
        assert jobs.list(JobQuery()).jobs[0].progress == progress  # type: ignore[union-attr]

    def test_a_save_does_not_write_progress(self, jobs: JobStore, job: Job) -> None:
        jobs.save(job.running().model_copy(update={"progress": Progress(step=999)}))
        assert jobs.get(job.id).progress == Progress()

    def test_progress_moves_no_version(self, jobs: JobStore, job: Job) -> None:
        jobs.record(job.id, job.token, "events", [], Progress(step=1), write_id="w")
        jobs.save(job.running())
        assert jobs.get(job.id).version == job.version + 1


class TestTokens:
    @pytest.mark.parametrize("token", ["", "1-0000000000000000"])
    def test_a_stale_token_writes_nothing(self, jobs: JobStore, job: Job, token: str) -> None:
        with pytest.raises(LeaseLost):
            jobs.record(job.id, token, "events", [line("a")], Progress(step=5), write_id="w")
        assert [entry.kind for entry in jobs.feed(job.id, "events").entries] == ["status"]
        assert jobs.get(job.id).progress == Progress()

    def test_an_attempt_that_lost_its_job_writes_nothing(self, jobs: JobStore, job: Job) -> None:
        requeued = taken_back(job)
        jobs.save(requeued)
        jobs.save(requeued.claimed("worker-2", NOW), lease=LEASE)
        with pytest.raises(LeaseLost):
            say(jobs, job, "late")
        assert logs(jobs, job) == []

    def test_an_attempt_says_nothing_behind_the_word_that_it_lost_its_job(self, jobs: JobStore) -> None:
        note = Entry(kind="note", time=NOW, data={})
        for i in range(30):
            job = held(jobs, queued_job(i))
            say_so = partial(jobs.record, job.id, job.token, "events", [note], write_id="w")
            was_heard, _ = at_once([say_so, partial(jobs.save, taken_back(job))], LeaseLost)
            kinds = [entry.kind for entry in jobs.feed(job.id, "events").entries]
            assert kinds == (["status", "note", "status"] if was_heard else ["status", "status"])

    def test_an_ended_job_takes_no_entries(self, jobs: JobStore, job: Job) -> None:
        jobs.save(job.ended(JobStatus.FAILED, Reason.DIVERGED, "", NOW))
        with pytest.raises(LeaseLost):
            say(jobs, job, "late")
        with pytest.raises(LeaseLost):
            jobs.record(new_job_id(NOW), job.token, "logs", [line("late")], write_id="w")


class TestMarks:
    def test_a_mark_moves_with_every_step_and_every_entry(self, jobs: JobStore, job: Job) -> None:
        assert jobs.marks([job.id]) == {job.id: Mark(2, 1, 0)}
        say(jobs, job, "a", "b")
        assert jobs.marks([job.id]) == {job.id: Mark(2, 1, 2)}
        jobs.save(job.running())
        assert jobs.marks([job.id]) == {job.id: Mark(3, 2, 2)}
        compact(jobs, job, 1)
        assert jobs.marks([job.id]) == {job.id: Mark(3, 2, 2)}

    def test_those_that_are_not_there_are_left_out(self, jobs: JobStore, job: Job) -> None:
        other = held(jobs, queued_job(1))
        assert set(jobs.marks([job.id, new_job_id(NOW), other.id])) == {job.id, other.id}
        assert dict(jobs.marks([])) == {}


class TestChunks:
    def test_a_chunk_takes_the_place_of_its_entries(self, jobs: JobStore, job: Job) -> None:
        say(jobs, job, "a", "b", "c")
        chunk = compact(jobs, job, 2)
        part = jobs.feed(job.id, "logs")
        assert (list(part.chunks), texts(part.entries)) == ([chunk], ["c"])
        assert texts(jobs.oldest_entries(job.id, "logs", limit=9)) == ["c"]
        assert len(jobs.feed(job.id, "events").entries) == 1

    def test_the_same_chunk_twice_is_once(self, jobs: JobStore, job: Job) -> None:
        say(jobs, job, "a", "b", "c")
        chunk = compact(jobs, job, 2)
        jobs.replace_by_chunk(job.id, chunk)
        part = jobs.feed(job.id, "logs")
        assert (list(part.chunks), texts(part.entries)) == ([chunk], ["c"])

    @pytest.mark.parametrize("lengths", [(2, 3), (3, 2)])
    def test_of_two_chunks_that_begin_alike_the_first_stays(
        self, jobs: JobStore, job: Job, lengths: tuple[int, int]
    ) -> None:
        say(jobs, job, "a", "b", "c", "d")
        entries = jobs.oldest_entries(job.id, "logs", limit=9)
        first, second = (chunk_of(entries[:length], f"of {length}") for length in lengths)
        jobs.replace_by_chunk(job.id, first)
        jobs.replace_by_chunk(job.id, second)
        part = jobs.feed(job.id, "logs")
        assert list(part.chunks) == [first]
        assert texts(part.entries) == ["a", "b", "c", "d"][lengths[0] :]

    def test_of_many_chunks_made_at_once_one_stays(self, jobs: JobStore, job: Job) -> None:
        say(jobs, job, *map(str, range(20)))
        entries = jobs.oldest_entries(job.id, "logs", limit=20)
        made = [chunk_of(entries[: 2 * i], f"chunk {i}") for i in range(1, 9)]
        assert all(at_once([partial(jobs.replace_by_chunk, job.id, chunk) for chunk in made], JobNotFound))
        part = jobs.feed(job.id, "logs")
        (chunk,) = part.chunks
        assert chunk in made
        assert texts(part.entries) == [str(i) for i in range(chunk.last, 20)]

    def test_a_chunk_of_a_job_deleted_meanwhile_is_passed_over(self, jobs: JobStore, job: Job) -> None:
        say(jobs, job, "a")
        chunk = chunk_of(jobs.oldest_entries(job.id, "logs", limit=1))
        jobs.delete(job.id, job.version)
        jobs.replace_by_chunk(job.id, chunk)
        assert jobs.objects_named([job.id]) == set()

    def test_a_reader_in_the_midst_of_a_chunk_gets_it_and_what_follows(
        self, jobs: JobStore, job: Job
    ) -> None:
        say(jobs, job, *"abcdefg")
        first, second = compact(jobs, job, 3), compact(jobs, job, 3)
        for after, expected in ((0, [first, second]), (2, [first, second]), (3, [second]), (5, [second])):
            part = jobs.feed(job.id, "logs", after=after)
            assert (list(part.chunks), texts(part.entries)) == (expected, ["g"])
        assert jobs.feed(job.id, "logs", after=6).chunks == []
        assert logs(jobs, job, after=6) == ["g"]
        assert logs(jobs, job, after=7) == []

    def test_many_chunks_come_a_few_at_a_time_and_no_entries_before_the_last_of_them(
        self, jobs: JobStore, job: Job
    ) -> None:
        say(jobs, job, *map(str, range(12)))
        made = [compact(jobs, job, 1) for _ in range(11)]
        got: list[Chunk] = []
        after = 0
        while len(part := jobs.feed(job.id, "logs", after=after).chunks) and len(got) < 11:
            assert len(part) <= 4
            got += part
            after = part[-1].last
            if after < 11:
                assert logs(jobs, job, after=after - len(part)) == []
        assert got == made
        assert logs(jobs, job, after=11) == ["11"]

    def test_numbers_go_on_behind_a_chunk(self, jobs: JobStore, job: Job) -> None:
        say(jobs, job, "a", "b")
        compact(jobs, job, 2)
        say(jobs, job, "c")
        assert [entry.id for entry in jobs.feed(job.id, "logs", after=2).entries] == ["3"]

    def test_a_write_sent_again_after_its_entries_went_into_a_chunk_changes_nothing(
        self, jobs: JobStore, job: Job
    ) -> None:
        write = partial(jobs.record, job.id, job.token, "logs", [line("a")], write_id="w")
        write()
        chunk = compact(jobs, job, 1)
        write()
        part = jobs.feed(job.id, "logs")
        assert (list(part.chunks), list(part.entries)) == ([chunk], [])


class TestMetrics:
    """Rows in blocks, which have their numbers among the events."""

    def test_rows_and_other_events_come_in_the_order_in_which_they_were_written(
        self, jobs: JobStore, job: Job
    ) -> None:
        note = Entry(kind="note", time=NOW)
        jobs.record(job.id, job.token, "events", [note, row(1), note, row(2)], write_id="a")
        jobs.record(job.id, job.token, "events", [row(3, "other"), row(3), note], write_id="b")
        entries = jobs.feed(job.id, "events").entries
        assert [entry.id for entry in entries] == [str(number) for number in range(1, 9)]
        said = ["status", "note", ["reward"], "note", ["reward"], ["other"], ["reward"], "note"]
        assert [
            [*entry.data["values"]] if entry.kind == "metrics" else entry.kind for entry in entries
        ] == said
        part = jobs.feed_metrics(job.id, after=3)
        assert (list(part.chunks), part.last, part.is_end) == ([], 8, True)
        assert steps(part) == {3: 1, 5: 2, 6: 3, 7: 3}  # Of a block that reaches beyond 3.
        assert steps(jobs.feed_metrics(job.id, after=8)) == {}

    def test_reading_resumes_after_a_number_and_at_a_limit(self, jobs: JobStore, job: Job) -> None:
        for step in range(5):
            note = Entry(kind="note", time=NOW, data={"step": step})
            jobs.record(job.id, job.token, "events", [row(step), row(step), note], write_id=str(step))
        for limit in (1, 2, 3, 100):
            after, found, is_end = 1, list[int](), False
            while not is_end:
                part = jobs.feed(job.id, "events", after=after, limit=limit)
                assert len(part.entries) <= limit
                found += [entry.data["step"] for entry in part.entries]
                after, is_end = part.last, part.is_end
            assert found == [step for step in range(5) for _ in range(3)]

    def test_a_repeated_write_changes_nothing_and_one_of_a_lost_lease_is_refused(
        self, jobs: JobStore, job: Job
    ) -> None:
        for _ in range(2):
            jobs.record(job.id, job.token, "events", [row(1)], write_id="same")
        with pytest.raises(LeaseLost):
            jobs.record(job.id, "1-other", "events", [row(2)], write_id="w")
        assert steps(jobs.feed_metrics(job.id)) == {2: 1}

    def test_the_oldest_blocks_become_a_chunk_and_the_rest_stays_behind_it(
        self, jobs: JobStore, job: Job
    ) -> None:
        for step in range(3):
            jobs.record(job.id, job.token, "events", [row(step)], write_id=str(step))
        assert due(jobs, job) == []
        assert due(jobs, job, max_bytes=100) == ["metrics"]
        [(first, _)] = jobs.oldest_metrics(job.id, max_bytes=1)
        chunk = Chunk("metrics", first, first, "key", size=1, sha256="0" * 64)
        for _ in range(2):
            jobs.replace_by_chunk(job.id, chunk)
        part = jobs.feed_metrics(job.id)
        assert (list(part.chunks), steps(part)) == ([chunk], {3: 1, 4: 2})
        assert list(jobs.feed_metrics(job.id, after=first).chunks) == []
        assert [found.channel for found in jobs.feed(job.id, "events").chunks] == ["metrics"]
        jobs.save(job.ended(JobStatus.FAILED, Reason.DIVERGED, "", NOW))
        assert due(jobs, job) == ["events", "metrics"]


def row(step: int, name: str = "reward") -> Entry:
    return Entry(kind="metrics", time=NOW, data={"step": step, "values": {name: float(step)}})


def steps(part: MetricsPart) -> dict[int, int]:
    """The steps of its rows in the record, by their numbers."""
    blocks = [Block.decode(body, first) for first, body in part.blocks]
    return {one.number: one.step for block in blocks for one in block.rows()}


class TestLongFeeds:
    """Which entries are due to become a chunk."""

    def test_a_short_new_feed_of_a_running_job_is_not_due(self, jobs: JobStore, job: Job) -> None:
        recent(jobs, job, "x" * 100)
        assert ("logs" not in due(jobs, job), due(jobs, job, max_bytes=1000)) == (True, [])

    def test_a_feed_of_many_bytes_is_due(self, jobs: JobStore, job: Job) -> None:
        recent(jobs, job, "x" * 500)
        recent(jobs, job, "x" * 500)
        assert due(jobs, job, max_bytes=1000) == ["logs"]
        compact(jobs, job, 1)
        assert due(jobs, job, max_bytes=1000) == []

    def test_a_feed_with_an_old_entry_is_due(self, jobs: JobStore, job: Job, database: Database) -> None:
        recent(jobs, job, "a")
        recent(jobs, job, "b")
        older = "UPDATE entries SET stored_at = stored_at - %s WHERE channel = 'logs' AND number = 1"
        database.change(older, AN_HOUR)
        assert due(jobs, job, max_bytes=10**6) == ["logs"]
        compact(jobs, job, 1)
        assert due(jobs, job, max_bytes=10**6) == []

    def test_what_is_left_of_an_ended_job_is_due(self, jobs: JobStore, job: Job) -> None:
        recent(jobs, job, "a")
        jobs.save(job.ended(JobStatus.FAILED, Reason.DIVERGED, "", NOW))
        assert due(jobs, job, max_bytes=10**6) == ["events", "logs"]
        compact(jobs, job, 1)
        assert due(jobs, job, max_bytes=10**6) == ["events"]

    def test_the_oldest_entries_come_first_up_to_the_limit(self, jobs: JobStore, job: Job) -> None:
        say(jobs, job, *"abcd")
        assert texts(jobs.oldest_entries(job.id, "logs", limit=2)) == ["a", "b"]
        assert list(jobs.oldest_entries(new_job_id(NOW), "logs", limit=2)) == []


def recent(jobs: JobStore, job: Job, text: str) -> None:
    """A line of this moment."""
    entry = Entry(kind="line", time=jobs.now(), data={"text": text})
    jobs.record(job.id, job.token, "logs", [entry], write_id=secrets.token_hex(8))


def due(jobs: JobStore, job: Job, max_bytes: int = 10**6) -> list[str]:
    found = jobs.long_feeds(max_bytes=max_bytes, max_age=timedelta(minutes=10), max_metrics_bytes=max_bytes)
    assert {job_id for job_id, _ in found} <= {job.id}
    return sorted(channel for _, channel in found)


class TestWritingMeanwhile:
    """A write that had to wait for another one's lock looks again at what the other one has left."""

    @pytest.fixture
    def locked(self, database_url: str, job: Job) -> Iterator[psycopg.Connection[Any]]:
        """A transaction that has the job's row, as another process would."""
        with psycopg.connect(database_url) as other:
            other.execute("SELECT id FROM jobs WHERE id = %s FOR UPDATE", [job.id])
            yield other

    @staticmethod
    def wait_for_a_waiter(other: psycopg.Connection[Any]) -> None:
        until = time.monotonic() + 10
        waits = "SELECT count(*) FROM pg_locks WHERE NOT granted"
        while other.execute(waits).fetchone() == (0,):
            assert time.monotonic() < until
            time.sleep(0.01)

    def test_it_is_refused_where_the_job_was_taken_back(
        self, jobs: JobStore, job: Job, locked: psycopg.Connection[Any]
    ) -> None:
        with ThreadPoolExecutor(1) as pool:
            written = pool.submit(say, jobs, job, "too late")
            self.wait_for_a_waiter(locked)
            locked.execute("UPDATE jobs SET token = '2-other' WHERE id = %s", [job.id])
            locked.commit()
            with pytest.raises(LeaseLost):
                written.result(10)
        assert logs(jobs, job) == []

    def test_it_is_numbered_behind_what_came_between(
        self, jobs: JobStore, job: Job, locked: psycopg.Connection[Any]
    ) -> None:
        with ThreadPoolExecutor(1) as pool:
            written = pool.submit(say, jobs, job, "a", "b")
            self.wait_for_a_waiter(locked)
            locked.execute("UPDATE jobs SET num_logs = num_logs + 3 WHERE id = %s", [job.id])
            locked.commit()
            written.result(10)
        assert [entry.id for entry in jobs.feed(job.id, "logs").entries] == ["4", "5"]

    def test_the_same_write_sent_twice_at_once_is_there_once(
        self, jobs: JobStore, job: Job, locked: psycopg.Connection[Any]
    ) -> None:
        entry = Entry(kind="line", time=NOW, data={"text": "a"})
        write = partial(jobs.record, job.id, job.token, "logs", [entry], write_id="w")
        with ThreadPoolExecutor(2) as pool:
            both = [pool.submit(write), pool.submit(write)]
            self.wait_for_a_waiter(locked)
            locked.commit()
            for one in both:
                one.result(10)
        assert logs(jobs, job) == ["a"]


class TestReadingMeanwhile:
    def test_a_reader_sees_no_gap_and_no_double_while_others_write_and_compact(
        self, jobs: JobStore, job: Job
    ) -> None:
        # Chunks of seven entries or fewer are made of what a writer appends in batches of one to five.
        most = 400
        done = threading.Event()

        def write() -> None:
            written = 0
            while written < most:
                batch = range(written, written + 1 + written % 5)
                say(jobs, job, *map(str, batch))
                written = batch[-1] + 1
            done.set()

        def compact_all() -> None:
            while not done.is_set():
                if entries := jobs.oldest_entries(job.id, "logs", limit=7):
                    jobs.replace_by_chunk(job.id, chunk_of(entries))

        def read() -> int:
            num_looks = 0
            while not done.is_set():
                numbers = list(numbers_of(jobs, job))
                assert numbers == list(range(1, len(numbers) + 1))
                num_looks += 1
            return num_looks

        with ThreadPoolExecutor(4) as pool:
            tasks = [pool.submit(write), pool.submit(compact_all), pool.submit(compact_all)]
            assert pool.submit(read).result(60) > 0
            for task in tasks:
                task.result(60)
        assert len(list(numbers_of(jobs, job))) >= most
        assert jobs.feed(job.id, "logs").chunks


def numbers_of(jobs: JobStore, job: Job) -> Iterator[int]:
    """Of all entries, by as many looks as it takes; each look has to join the one before."""
    after = 0
    while True:
        part = jobs.feed(job.id, "logs", after=after, limit=5)
        found = [number for chunk in part.chunks for number in range(chunk.first, chunk.last + 1)]
        found = [number for number in found if number > after]
        found += [int(entry.id) for entry in part.entries]
        if not found:
            return
        yield from found
        after = found[-1]
