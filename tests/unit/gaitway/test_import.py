"""`gaitway import-0.1`: what version 0.1 itself wrote (version_01/data.json) becomes part of the record."""

import base64
import hashlib
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import redis

from core.adapters.connect import connect_redis, job_store
from core.adapters.memory.queue import MemoryJobQueue
from core.adapters.postgres.jobs import PostgresJobStore
from core.adapters.s3.connection import connect_s3
from core.adapters.s3.objects import S3ObjectStore
from core.errors import IdempotencyKeyReused, ModelNotFound
from core.jobs import feeds
from core.jobs.attempts import claim_attempt
from core.jobs.deletion import delete
from core.jobs.job import Artifact, Job, Progress
from core.jobs.reconciliation import Reconciler
from core.jobs.status import JobStatus
from core.jobs.store import Channel, Dispatch, Entry, Idempotency, JobQuery
from core.reasons import Reason
from core.settings import StoreSettings, WorkerSettings
from core.variables import variable
from gaitway.service.embedded.importing import import_folder
from gaitway.service.embedded.processes import ServerFailed
from gaitway.service.embedded.servers import EmbeddedServers
from gaitway.service.embedded.stack import lock_folder
from gaitway.service.embedded.valkey import Valkey
from gaitway.service.embedded.version_01 import report_if_left
from gaitway.service.embedded.weed import Weed
from gaitway.service.embedded.weed_environment import REGION
from gaitway.service.import_01 import ImportRefused, import_stores, refuse_while_at_work

OLD: dict[str, Any] = json.loads((Path(__file__).parent / "version_01" / "data.json").read_text())
IDS: dict[str, str] = OLD["jobs"]
MODELS: dict[str, str] = OLD["models"]
LEASE = timedelta(seconds=15)


def load_redis(client: Any) -> None:
    """Everything that version 0.1 had there."""
    for key, found in OLD["redis"].items():
        value = found["value"]
        match found["type"]:
            case "hash":
                client.hset(key, mapping=value)
            case "stream":
                for at, said in value:
                    client.xadd(key, said, id=at)
            case "zset":
                client.zadd(key, dict.fromkeys(value, 0))
            case _:
                client.set(key, value)
        if found["expires_ms"] > 0:
            client.pexpire(key, found["expires_ms"])


def load_objects(store: S3ObjectStore) -> None:
    for key, body in OLD["objects"].items():
        store.put(key, base64.b64decode(body))


class Old:
    """Version 0.1's data on the test's servers, and what may have become of them."""

    def __init__(self, settings: WorkerSettings, client: Any, objects: S3ObjectStore) -> None:
        self.settings, self.redis, self.objects = settings, client, objects
        load_redis(client)
        load_objects(objects)

    def import_all(self, *, without_redis: bool = False) -> tuple[bool, list[str]]:
        """Whether all could be read, and what was said."""
        said: list[str] = []
        return import_stores(self.settings, said.append, without_redis=without_redis), said

    def live(self, name: str) -> dict[str, Any]:
        """The document in Redis."""
        return json.loads(self.redis.hget(f"gaitway:job:{IDS[name]}", "document"))

    def write_live(self, name: str, document: dict[str, Any] | str, **fields: Any) -> None:
        text = document if isinstance(document, str) else json.dumps(document)
        self.redis.hset(f"gaitway:job:{IDS[name]}", mapping={"document": text, **fields})

    def copy(self, name: str) -> dict[str, Any]:
        """The document in the object store."""
        return json.loads(self.objects.get(f"jobs/{IDS[name]}/record.json"))

    def write_copy(self, name: str, document: dict[str, Any] | str) -> None:
        text = document if isinstance(document, str) else json.dumps(document)
        self.objects.put(f"jobs/{IDS[name]}/record.json", text.encode())


@pytest.fixture
def old(settings: WorkerSettings, redis_client: redis.Redis, object_store: S3ObjectStore) -> Old:
    return Old(settings, redis_client, object_store)


def listed(store: PostgresJobStore) -> dict[str, Job]:
    """Every job in the record, by the name that the fixture gave it."""
    names = {job_id: name for name, job_id in IDS.items()}
    found = store.list(JobQuery(), limit=1000).jobs
    assert all(isinstance(job, Job) for job in found)
    return {names[job.id]: job for job in found if isinstance(job, Job)}


def feed(old: Old, store: PostgresJobStore, name: str, channel: Channel = "events") -> Sequence[Entry]:
    return feeds.read(IDS[name], channel, store=store, objects=old.objects, limit=100_000)


def streamed(name: str, channel: Channel = "events") -> list[tuple[str, datetime, dict[str, Any]]]:
    """What version 0.1 had in the feed."""
    found = OLD["redis"][f"gaitway:job:{IDS[name]}:{channel}"]["value"]
    entries = [Entry.model_validate_json(said["entry"]) for _, said in found]
    return [(entry.kind, entry.time, entry.data) for entry in entries]


def told(entries: Sequence[Entry]) -> list[tuple[str, datetime, dict[str, Any]]]:
    return [(entry.kind, entry.time, entry.data) for entry in entries]


class TestJobs:
    def test_every_job_is_there_ended_or_queued(self, old: Old, job_store: PostgresJobStore) -> None:
        assert old.import_all()[0]
        assert {name: job.status.value for name, job in listed(job_store).items()} == {
            "succeeded": "succeeded",
            "running": "queued",
            "queued": "queued",
            "rollout": "queued",
            "cancelled": "cancelled",
            "cancelling": "cancelled",  # No worker is left that could do it.
            "failed": "failed",
            "starting": "queued",
        }

    def test_ended_and_queued_ones_are_as_they_were(self, old: Old, job_store: PostgresJobStore) -> None:
        before = {
            name: Job.model_validate({**old.live(name), "progress": self.progress(old, name)})
            for name in ("succeeded", "queued", "rollout", "cancelled", "failed")
        }
        old.import_all()
        after = listed(job_store)
        assert {name: after[name] for name in before} == before
        assert before["succeeded"].progress.step == 300

    @staticmethod
    def progress(old: Old, name: str) -> Progress:
        found: Any = old.redis.hget(f"gaitway:job:{IDS[name]}", "progress")
        return Progress.model_validate_json(found)

    def test_one_that_ran_waits_for_its_next_attempt_with_its_newest_checkpoint(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        old.import_all()
        job = job_store.get(IDS["running"])
        assert [(a.number, a.reason, a.ended_at is None) for a in job.attempts] == [
            (1, Reason.WORKER_LOST, False),
            (2, Reason.WORKER_LOST, False),
        ]
        assert job.attempts[1].message is not None
        assert "imported" in job.attempts[1].message
        assert (job.attempts[1].device, job.attempts[1].engine) == ("cpu", "native")
        checkpoint = job.newest("checkpoint")
        assert checkpoint is not None
        # The key is as it was, and leads to the file.
        assert checkpoint.key == f"jobs/{job.id}/attempts/2/checkpoint-300.msgpack"
        assert old.objects.get(checkpoint.key) == b"checkpoint of step 300"

    def test_what_waits_is_dispatched_and_can_be_claimed(self, old: Old, job_store: PostgresJobStore) -> None:
        old.import_all()
        queue = MemoryJobQueue()
        Reconciler(job_store, queue, LEASE).look()
        waiting = {"running": 3, "queued": 1, "rollout": 1, "starting": 2}
        assert sorted(queue.known()) == sorted((IDS[name], number) for name, number in waiting.items())
        assert job_store.undispatched() == []
        claim = claim_attempt(
            IDS["running"], 3, "w", store=job_store, objects=old.objects, lease=LEASE, secret="secret"
        )
        assert claim is not None
        claim.start(device="cpu")
        assert job_store.get(IDS["running"]).status == JobStatus.RUNNING

    def test_a_job_that_needs_another_ones_checkpoint_comes_after_it(
        self, old: Old, job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        stored: list[str] = []
        original = PostgresJobStore.import_job

        def noting(store: PostgresJobStore, job: Job, *rest: Any) -> bool:
            stored.append(job.id)
            return original(store, job, *rest)

        monkeypatch.setattr(PostgresJobStore, "import_job", noting)
        old.import_all()
        assert stored == sorted(IDS.values())
        assert [borrower for borrower, _ in job_store.borrowers_of(IDS["succeeded"])] == [IDS["rollout"]]

    def test_a_client_that_sends_again_finds_its_job(self, old: Old, job_store: PostgresJobStore) -> None:
        old.import_all()
        found = job_store.remembered(Idempotency("a key", "fingerprint of queued"))
        assert found == job_store.get(IDS["queued"])
        with pytest.raises(IdempotencyKeyReused):
            job_store.remembered(Idempotency("a key", "another fingerprint"))

    def test_a_key_that_was_used_since_stays_with_the_newer_job(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        newer = Job.model_validate({**old.live("queued"), "id": "01a200000000-0000000000"})
        job_store.add(newer, Idempotency("a key", "newer"))
        assert old.import_all()[0]
        assert job_store.remembered(Idempotency("a key", "newer")) == newer
        assert job_store.get(IDS["queued"]).status == JobStatus.QUEUED


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


class TestWithoutRedis:
    """What Redis had is lost, and the user says so."""

    def test_jobs_come_from_their_copies_and_submissions(self, old: Old, job_store: PostgresJobStore) -> None:
        old.redis.flushall()
        assert old.import_all(without_redis=True)[0]
        assert {name: job.status.value for name, job in listed(job_store).items()} == {
            "succeeded": "succeeded",
            "running": "queued",
            "queued": "queued",
            "rollout": "queued",
            "cancelled": "cancelled",
            "cancelling": "queued",  # Redis alone knew of the cancel.
            "failed": "failed",
            "starting": "queued",
        }

    def test_a_copy_of_an_ended_job_is_the_whole_of_it(self, old: Old, job_store: PostgresJobStore) -> None:
        before = Job.model_validate(old.copy("succeeded"))
        old.import_all(without_redis=True)
        assert job_store.get(IDS["succeeded"]) == before

    def test_files_that_only_manifests_name_are_found(self, old: Old, job_store: PostgresJobStore) -> None:
        # The copy was made when the second attempt began: what that one made stands in its manifest.
        assert not any(a["name"] == "checkpoint-300.msgpack" for a in old.copy("running")["artifacts"])
        old.import_all(without_redis=True)
        job = job_store.get(IDS["running"])
        assert sorted(artifact.key.partition("attempts/")[2] for artifact in job.artifacts) == [
            "1/checkpoint-200.msgpack",
            "2/checkpoint-300.msgpack",
            "2/metrics.jsonl",
        ]
        for artifact in job.artifacts:
            assert hashlib.sha256(old.objects.get(artifact.key)).hexdigest() == artifact.sha256

    def test_events_are_told_from_the_metrics_and_the_end(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        old.import_all(without_redis=True)
        *metrics, last = feed(old, job_store, "succeeded")
        assert told(metrics) == [entry for entry in streamed("succeeded") if entry[0] == "metrics"]
        assert (last.kind, last.time) == ("status", job_store.get(IDS["succeeded"]).finished_at)
        assert last.data == {
            "status": "succeeded",
            "reason": "completed",
            "message": "All 1,000 steps are done.",
            "attempt": 1,
        }
        assert feed(old, job_store, "succeeded", "logs") == []

    def test_a_log_that_is_a_file_is_told_by_line(self, old: Old, job_store: PostgresJobStore) -> None:
        document, body = old.copy("failed"), "first\n\nthird\n"
        artifact = Artifact(
            name="log.txt",
            role="log",
            media_type="text/plain",
            size=len(body),
            sha256=hashlib.sha256(body.encode()).hexdigest(),
            key=f"jobs/{IDS['failed']}/attempts/1/log.txt",
        )
        old.objects.put(artifact.key, body.encode())
        old.write_copy("failed", {**document, "artifacts": [artifact.model_dump(mode="json")]})
        old.import_all(without_redis=True)
        assert [entry.data["text"] for entry in feed(old, job_store, "failed", "logs")] == [
            "first",
            "",
            "third",
        ]

    def test_an_empty_redis_is_no_reason_to_do_without_it(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        # It may not have loaded its file, or be another one; its logs would never come again.
        old.redis.flushall()
        with pytest.raises(
            ImportRefused, match=r"8 jobs of version 0\.1, and Redis has none.*--without-redis"
        ):
            old.import_all()
        assert listed(job_store) == {}

    def test_a_redis_that_is_emptied_after_the_import_is_not_missed(self, old: Old) -> None:
        old.import_all()
        old.redis.flushall()
        assert old.import_all()[0]


class TestNewest:
    def test_a_copy_that_is_newer_than_redis_counts(self, old: Old, job_store: PostgresJobStore) -> None:
        # Redis was killed, and lost its last second.
        ended = Job.model_validate(old.copy("failed"))
        stale = {**old.live("failed"), "version": ended.version - 1, "status": "running", "finished_at": None}
        old.write_live("failed", stale, version=ended.version - 1)
        old.import_all()
        assert job_store.get(IDS["failed"]) == ended

    def test_a_checkpoint_that_redis_lost_is_found_by_its_manifest(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        document = old.live("running")
        document["artifacts"] = [a for a in document["artifacts"] if a["step"] != 300]
        old.write_live("running", document)
        old.import_all()
        newest = job_store.get(IDS["running"]).newest("checkpoint")
        assert newest is not None
        assert newest.step == 300

    def test_a_newer_attempts_file_is_not_replaced_by_an_older_ones(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        # The worker died between the record and its manifest.
        old.objects.delete([f"jobs/{IDS['running']}/attempts/2/manifest.json"])
        old.import_all()
        metrics = job_store.get(IDS["running"]).newest("metrics")
        assert metrics is not None
        assert metrics.key == f"jobs/{IDS['running']}/attempts/2/metrics.jsonl"

    def test_a_damaged_document_with_an_equal_copy_is_read_from_that(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        before = Job.model_validate(old.copy("succeeded"))
        old.write_live("succeeded", '{"id": "01')
        assert old.import_all()[0]
        assert job_store.get(IDS["succeeded"]) == before

    def test_an_older_copy_does_not_stand_in_for_a_damaged_document(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        # The copy does not know of the cancel: the job would run.
        old.write_live("cancelling", '{"id": "01')
        is_whole, _ = old.import_all()
        assert not is_whole
        assert "cancelling" not in listed(job_store)


DAMAGES: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "no JSON": (lambda document: '{"id": "01', "Unterminated string"),
    "no object": (lambda document: "[]", "not a JSON object"),
    "no specification": (lambda document: {**document, "spec": None}, "its specification: Input should be"),
    "another job's": (lambda document: {**document, "id": IDS["queued"]}, f"belongs to job {IDS['queued']}"),
    "an unknown status": (lambda document: {**document, "status": "asleep"}, "status"),
    "a number of the wrong kind": (
        lambda document: {**document, "spec": {**document["spec"], "seed": "many"}},
        "seed",
    ),
    # Python has room for it, and PostgreSQL has not.
    "a version that is too large": (lambda document: {**document, "version": 2**40}, "out of range"),
}


class TestDamage:
    @pytest.mark.parametrize("damage", DAMAGES)
    def test_a_record_that_cannot_be_read_is_named_and_the_others_come(
        self, damage: str, old: Old, job_store: PostgresJobStore
    ) -> None:
        change, words = DAMAGES[damage]
        document = change(old.live("failed"))
        old.write_live("failed", document)
        old.write_copy("failed", document)
        is_whole, said = old.import_all()
        assert not is_whole
        (line,) = [line for line in said if IDS["failed"] in line]
        assert "is skipped" in line
        assert re.search(words, line)
        assert set(listed(job_store)) == set(IDS) - {"failed"}
        assert said[-1] == "Jobs: 7 imported, 0 in the record before, 1 not readable."

    def test_fields_that_nobody_knows_are_passed_over(self, old: Old, job_store: PostgresJobStore) -> None:
        document = old.live("running")
        before = Job.model_validate(document)
        document["colour"] = "green"
        document["attempts"][0]["mood"] = "good"
        document["artifacts"][0]["weight"] = 1
        document["spec"]["haste"] = {"much": True}
        document["spec"]["environment"]["haste"] = 1
        old.write_live("running", document)
        assert old.import_all()[0]
        job = job_store.get(IDS["running"])
        assert (job.spec, job.artifacts, job.attempts[0]) == (
            before.spec,
            before.artifacts,
            before.attempts[0],
        )

    def test_progress_that_was_not_finite_loses_that_number_alone(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        progress = '{"step":300,"total":1000,"steps_per_second":5.0,"eta_s":1.0,"metrics":{"a":null,"b":2.0}}'
        old.write_live("running", old.live("running"), progress=progress)
        old.import_all()
        found = job_store.get(IDS["running"]).progress
        assert (found.step, found.metrics) == (300, {"b": 2.0})

    def test_a_job_that_was_deleted_does_not_come_back(self, old: Old, job_store: PostgresJobStore) -> None:
        # A deletion removes the files first: cut short, it leaves the record in Redis.
        old.objects.delete_prefix(f"jobs/{IDS['failed']}/")
        is_whole, said = old.import_all()
        assert is_whole
        assert set(listed(job_store)) == set(IDS) - {"failed"}
        assert any("1 jobs that Redis has are left out" in line for line in said)


class TestAgain:
    def test_a_second_import_changes_nothing(self, old: Old, job_store: PostgresJobStore) -> None:
        old.import_all()
        before, events = listed(job_store), {name: feed(old, job_store, name) for name in IDS}
        is_whole, said = old.import_all()
        assert is_whole
        assert said[-2:] == [
            "Models: 0 imported, 3 in the record before, 0 not readable.",
            "Jobs: 0 imported, 8 in the record before, 0 not readable.",
        ]
        assert listed(job_store) == before
        assert {name: feed(old, job_store, name) for name in IDS} == events

    def test_what_went_on_since_stays_and_what_was_deleted_since_stays_away(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        old.import_all()
        job = job_store.get(IDS["running"])
        job_store.save(job.claimed("w", job_store.now()), lease=LEASE)
        delete(IDS["failed"], store=job_store, objects=old.objects)
        old.import_all()
        assert job_store.get(job.id).status == JobStatus.STARTING
        assert set(listed(job_store)) == set(IDS) - {"failed"}

    def test_an_imported_job_without_its_old_papers_is_not_taken_for_deleted(self, old: Old) -> None:
        # The sweep of orphans may remove what no record names.
        old.import_all()
        old.objects.delete([f"jobs/{job_id}/spec.json" for job_id in IDS.values()])
        assert old.import_all() == (
            True,
            [
                "Models: 0 imported, 3 in the record before, 0 not readable.",
                "Jobs: 0 imported, 0 in the record before, 0 not readable.",
            ],
        )

    @pytest.mark.parametrize("after", [0, 3])
    def test_an_import_that_was_killed_is_finished_by_the_next(
        self, after: int, old: Old, job_store: PostgresJobStore
    ) -> None:
        killed = subprocess.run(
            [sys.executable, "-c", KILLED, str(after)],
            env={**os.environ, **environment_of(old.settings)},
            capture_output=True,
            text=True,
        )
        assert killed.returncode == -signal.SIGKILL, killed.stderr
        # Nothing of the job whose feed was just being stored: all of it is one transaction.
        assert sorted(job.id for job in listed(job_store).values()) == sorted(IDS.values())[:after]
        is_whole, said = old.import_all()
        assert is_whole
        assert said[-1] == f"Jobs: {8 - after} imported, {after} in the record before, 0 not readable."
        assert told(feed(old, job_store, "succeeded")) == streamed("succeeded")
        assert len(feed(old, job_store, "running")) == len(streamed("running")) + 1

    def test_nothing_of_version_01_is_changed(self, old: Old) -> None:
        before = {key: old.redis.dump(key) for key in old.redis.scan_iter()}
        old.import_all()
        assert {key: old.redis.dump(key) for key in old.redis.scan_iter()} == before
        for key, body in OLD["objects"].items():
            assert old.objects.get(key) == base64.b64decode(body)


# Imports like anybody, and dies while it stores the feed of the job after the first `argv[1]`.
KILLED = """
import os, signal, sys
from core.adapters.postgres.jobs import PostgresJobStore
from core.configuration import read
from core.settings import StoreSettings
from gaitway.service.import_01 import import_stores

original, count = PostgresJobStore.import_job, 0

def dying(logs):
    yield from logs
    os.kill(os.getpid(), signal.SIGKILL)

def import_job(store, job, events, logs, keys):
    global count
    count += 1
    return original(store, job, events, dying(logs) if count > int(sys.argv[1]) else logs, keys)

PostgresJobStore.import_job = import_job
import_stores(read(StoreSettings), print)
"""


def environment_of(settings: StoreSettings) -> dict[str, str]:
    """The settings as variables."""
    said = {name: getattr(settings, name) for name in StoreSettings.model_fields}
    plain = {
        name: value.get_secret_value() if hasattr(value, "get_secret_value") else str(value)
        for name, value in said.items()
        if value is not None
    }
    return {variable(name): value for name, value in plain.items()}


class TestModels:
    def test_every_model_is_there_as_it_was(self, old: Old, job_store: PostgresJobStore) -> None:
        old.import_all()
        found = {record.id: record for record in job_store.models()}
        assert {name: found[model_id].status for name, model_id in MODELS.items()} == {
            "ready": "ready",
            "validating": "validating",
            "refused": "refused",
        }
        assert found[MODELS["refused"]].message == "It has no joints."
        description = found[MODELS["ready"]].description
        assert description is not None
        assert (description.complete, description.inventory.bodies) == (True, ["box"])
        assert description.engines == {"native": None, "mjx": "It has a tendon."}

    def test_one_that_waits_for_its_validation_is_dispatched(
        self, old: Old, job_store: PostgresJobStore
    ) -> None:
        old.import_all()
        assert Dispatch("model", MODELS["validating"]) in job_store.undispatched()

    def test_what_was_found_out_since_stays(self, old: Old, job_store: PostgresJobStore) -> None:
        old.import_all()
        record = job_store.find_model(MODELS["validating"])
        job_store.settle_model(record.model_copy(update={"status": "refused", "message": "No."}))
        old.import_all()
        assert job_store.find_model(MODELS["validating"]).message == "No."

    def test_a_damaged_one_is_named_and_the_others_come(self, old: Old, job_store: PostgresJobStore) -> None:
        model_id = MODELS["ready"]
        old.objects.put(f"models/{model_id.removeprefix('sha256:')}/record.json", b'{"id": 1')
        is_whole, said = old.import_all()
        assert not is_whole
        assert any(model_id in line and "is skipped" in line for line in said)
        assert {record.id for record in job_store.models()} == set(MODELS.values()) - {model_id}
        with pytest.raises(ModelNotFound):
            job_store.find_model(model_id)
        assert set(listed(job_store)) == set(IDS)


class TestWhatIsSaid:
    def test_a_worker_of_version_01_that_is_alive_keeps_the_import_from_beginning(self, old: Old) -> None:
        refuse_while_at_work(old.settings)
        old.redis.sadd("gaitway:workers", "host-1", "host-2")
        old.redis.set("gaitway:worker:host-2", "{}", px=60_000)
        with pytest.raises(ImportRefused, match=r"still running: host-2\."):
            refuse_while_at_work(old.settings)

    def test_every_hundred_jobs_there_is_a_line(self, old: Old) -> None:
        document = old.live("queued")
        for number in range(195):
            job_id = f"01a200000000-{number:010x}"
            old.objects.put(f"jobs/{job_id}/spec.json", json.dumps({**document, "id": job_id}).encode())
        is_whole, said = old.import_all()
        assert is_whole
        assert said == [
            "100 of 203 jobs",
            "200 of 203 jobs",
            "Models: 3 imported, 0 in the record before, 0 not readable.",
            "Jobs: 203 imported, 0 in the record before, 0 not readable.",
        ]

    def test_nothing_to_import_is_no_failure(self, settings: WorkerSettings) -> None:
        said: list[str] = []
        assert import_stores(settings, said.append)
        assert said[-1] == "Jobs: 0 imported, 0 in the record before, 0 not readable."


def command(*arguments: str, **environment: str) -> "subprocess.CompletedProcess[str]":
    code = "from gaitway.cli.main import app; app()"
    base = {name: value for name, value in os.environ.items() if not name.startswith("GAITWAY_")}
    return subprocess.run(
        [sys.executable, "-c", code, "import-0.1", *arguments],
        env={**base, **environment},
        capture_output=True,
        text=True,
    )


class TestCommand:
    def test_its_exit_status_says_whether_all_could_be_read(self, old: Old) -> None:
        found = command(**environment_of(old.settings))
        assert (found.returncode, found.stderr) == (0, "")
        assert found.stdout.splitlines() == [
            "Models: 3 imported, 0 in the record before, 0 not readable.",
            "Jobs: 8 imported, 0 in the record before, 0 not readable.",
        ]

    def test_a_damaged_record_is_a_failure(self, old: Old) -> None:
        old.write_live("cancelling", "{")
        found = command(**environment_of(old.settings))
        assert (found.returncode, IDS["cancelling"] in found.stdout) == (1, True)

    def test_a_store_that_is_away_is_told_in_a_sentence(self, old: Old) -> None:
        away = {"GAITWAY_REDIS_URL": "unix:///nobody/is.here"}
        found = command(**{**environment_of(old.settings), **away})
        assert found.returncode == 1
        assert found.stderr.startswith("gaitway: Redis does not answer at GAITWAY_REDIS_URL")
        assert found.stderr.count("\n") == 1

    def test_missing_settings_are_named(self) -> None:
        found = command()
        assert found.returncode == 2
        assert "GAITWAY_DATABASE_URL is not set" in found.stderr
        assert "--data DIR" in found.stderr


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What the embedded stack of version 0.1 left when it ended."""
    data = tmp_path / "gaitway-data"
    data.mkdir()
    with Valkey(data / "valkey", append_only=True) as valkey, Weed(data / "objects") as weed:
        with connect_redis(valkey.url) as client:
            load_redis(client)
        s3 = connect_s3(weed.endpoint, weed.access_key, weed.secret_key, secure=False, region=REGION)
        load_objects(S3ObjectStore(s3, weed.bucket))
    return data


class TestFolder:
    def test_its_data_are_imported_once(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        reminded: list[str] = []
        report_if_left(folder, reminded.append)
        assert f"gaitway import-0.1 --data {folder}" in reminded[0]
        said: list[str] = []
        assert import_folder(folder, said.append)
        assert "Jobs: 8 imported, 0 in the record before, 0 not readable." in said
        assert not (folder / "valkey" / "appendonlydir").exists()
        assert (folder / "valkey" / "appendonlydir.imported" / "appendonly.aof.manifest").exists()
        report_if_left(folder, reminded.append)
        assert len(reminded) == 1
        with EmbeddedServers(folder) as servers:
            for name, value in servers.environment().items():
                monkeypatch.setenv(name, value)
            store = job_store(WorkerSettings(data_dir=folder))  # type: ignore[call-arg]
            assert set(listed(store)) == set(IDS)
            store.close()
        assert import_folder(folder, said.append)
        assert said[-1] == f"{folder} is imported already."

    def test_nobody_imports_beside_a_running_stack(self, folder: Path) -> None:
        with lock_folder(folder), pytest.raises(ServerFailed, match=f"Process {os.getpid()} already runs"):
            import_folder(folder, print)
        assert (folder / "valkey" / "appendonlydir").is_dir()

    def test_a_folder_of_something_else_is_refused_and_left_as_it_is(self, tmp_path: Path) -> None:
        found = command("--data", str(tmp_path / "nothing"))
        assert found.returncode == 1
        assert "is not a data folder of version 0.1" in found.stderr
        assert not (tmp_path / "nothing").exists()

    def test_records_of_a_second_time_are_kept_beside_the_first(self, tmp_path: Path) -> None:
        from gaitway.service.embedded.version_01 import set_aside

        for expected in ("appendonlydir.imported", "appendonlydir.imported-2", "appendonlydir.imported-3"):
            (tmp_path / "valkey" / "appendonlydir").mkdir(parents=True)
            assert set_aside(tmp_path).name == expected
