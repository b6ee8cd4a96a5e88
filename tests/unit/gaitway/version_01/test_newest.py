"""`gaitway import-0.1`: of several records of a job, the newest counts."""

from core.adapters.postgres.jobs import PostgresJobStore
from core.jobs.job import Job
from tests.unit.gaitway.version_01.old import (
    IDS,
    Old,
    listed,
)


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
