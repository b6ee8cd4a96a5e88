"""`gaitway import-0.1`: from the object store alone."""

import hashlib

import pytest

from core.adapters.postgres.jobs import PostgresJobStore
from core.jobs.job import Artifact, Job
from gaitway.service.import_01 import ImportRefused
from tests.unit.gaitway.version_01.old import IDS, Old, feed, listed, streamed, told


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
