"""`gaitway import-0.1`: jobs become part of the record."""

from typing import Any

import pytest

from core.adapters.memory.queue import MemoryJobQueue
from core.adapters.postgres.jobs import PostgresJobStore
from core.errors import IdempotencyKeyReused
from core.jobs.attempts import claim_attempt
from core.jobs.job import Job, Progress
from core.jobs.reconciliation import Reconciler
from core.jobs.status import JobStatus
from core.jobs.store import Idempotency
from core.reasons import Reason
from tests.unit.gaitway.version_01.old import IDS, LEASE, Old, listed


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
