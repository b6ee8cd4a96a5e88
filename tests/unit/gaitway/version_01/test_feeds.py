"""`gaitway import-0.1`: events and logs."""

from datetime import UTC, datetime

import pytest

from core.adapters.postgres.jobs import PostgresJobStore
from core.jobs import feeds
from core.jobs.store import Entry
from tests.unit.gaitway.version_01.old import IDS, Old, feed, streamed, told


class TestFeeds:
    @pytest.mark.parametrize("name", ["succeeded", "cancelled", "failed"])
    def test_events_are_those_that_redis_had(self, name: str, old: Old, job_store: PostgresJobStore) -> None:
        old.import_all()
        got = feed(old, job_store, name)
        assert told(got) == streamed(name)
        assert [entry.id for entry in got] == [str(number) for number in range(1, len(got) + 1)]

    def test_logs_are_those_that_redis_had(self, old: Old, job_store: PostgresJobStore) -> None:
        old.import_all()
        got = feed(old, job_store, "succeeded", "logs")
        assert told(got) == streamed("succeeded", "logs")
        assert got[-1].data["text"] == "a null \0, a snowman ☃ and a 🤖"

    @pytest.mark.parametrize(
        ("name", "status"), [("running", "queued"), ("starting", "queued"), ("cancelling", "cancelled")]
    )
    def test_the_last_event_of_an_interrupted_job_is_its_new_status(
        self, name: str, status: str, old: Old, job_store: PostgresJobStore
    ) -> None:
        old.import_all()
        *before, last = feed(old, job_store, name)
        assert told(before) == streamed(name)
        assert (last.kind, last.data["status"]) == ("status", status)

    def test_a_feed_of_many_pages_is_whole_and_in_order(self, old: Old, job_store: PostgresJobStore) -> None:
        key, lines = f"gaitway:job:{IDS['failed']}:logs", 4500
        with old.redis.pipeline() as pipeline:
            for number in range(lines):
                entry = Entry(kind="line", time=datetime(2026, 1, 1, tzinfo=UTC), data={"text": str(number)})
                # Several entries share a millisecond: pages end in the middle of one.
                said = {"kind": "line", "entry": entry.model_dump_json()}
                pipeline.xadd(key, said, id=f"{1 + number // 7}-{number % 7}")
            pipeline.execute()
        old.import_all()
        got = feed(old, job_store, "failed", "logs")
        assert [entry.data["text"] for entry in got] == [str(number) for number in range(lines)]

    def test_finished_parts_lie_in_the_object_store_at_once(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        # The feeds of thousands of jobs would else be rows of the database for a while.
        old.import_all()
        part = job_store.feed(IDS["succeeded"], "events")
        assert (len(part.chunks), part.entries) == (1, [])
        assert job_store.long_feeds(max_bytes=feeds.MAX_BYTES, max_age=feeds.MAX_AGE) == []

    def test_an_entry_that_cannot_be_read_leaves_a_note_in_its_place(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        key = f"gaitway:job:{IDS['failed']}:events"
        old.redis.xadd(key, {"kind": "metrics", "entry": '{"kind":'})
        assert old.import_all()[0]
        *before, last = feed(old, job_store, "failed")
        assert told(before) == streamed("failed")
        assert (last.kind, "could not be read" in last.data["text"]) == ("note", True)
