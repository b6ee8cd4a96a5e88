"""What the record promises of quotas: exact where jobs are added, and sums of what was used."""

from datetime import timedelta
from functools import partial

import pytest

from core.accounts.principal import Ownership
from core.accounts.store import Actor
from core.adapters.postgres.store import PostgresJobStore
from core.errors import QuotaExceeded, QuotaNotFound
from core.jobs.job import Job, utc_now
from core.jobs.quotas import QuotaUse
from core.jobs.store import Idempotency, JobStore
from core.jobs.turns import Quota
from core.reasons import Reason
from tests.contract.recording import LEASE, MODEL, Database, artifact, at_once, model, queued_job
from tests.unit.sweeps.making import sweep_of, trial_of

ANN = Ownership("ann", "gaits")


def of(job: Job, owner: str | None = "ann", project: str = "gaits") -> Job:
    return job.model_copy(update={"owner": owner, "project": project})


def limit(jobs: JobStore, kind: str = "project", name: str = "gaits", **quota: float | str | None) -> None:
    jobs.set_quota(kind, name, Quota(**quota), Actor())  # type: ignore[arg-type]


def used(jobs: JobStore) -> QuotaUse:
    (found,) = jobs.quota_uses()
    return found


def ran(jobs: JobStore, job: Job, ago: timedelta, worker: str = "node1:gpu:0,1:a1b2c3") -> None:
    """An attempt at a job on two GPUs that began so long ago and has ended now."""
    jobs.add(job)
    jobs.save(begun := job.claimed(worker, utc_now() - ago), lease=LEASE)
    jobs.save(begun.requeued(Reason.WORKER_LOST, "", utc_now()))


def test_a_quota_is_set_in_place_of_the_one_before_listed_and_removed(job_store: PostgresJobStore) -> None:
    limit(job_store, queued=3, weight=2.0)
    limit(job_store, queued=0, highest_priority="low")
    assert job_store.quotas().of("project", "gaits") == Quota(queued=0, highest_priority="low")
    assert used(job_store).quota == Quota(queued=0, highest_priority="low")
    job_store.remove_quota("project", "gaits", Actor())
    assert job_store.quota_uses() == []
    with pytest.raises(QuotaNotFound, match="for the project gaits"):
        job_store.remove_quota("project", "gaits", Actor())
    entries = job_store.audit(action="quota.").entries
    assert [entry.action for entry in entries] == ["quota.removed", "quota.set", "quota.set"]
    assert (entries[1].object, entries[1].details) == (
        "project gaits",
        {"weight": 1.0, "queued": 0, "highest_priority": "low"},
    )


@pytest.mark.parametrize(("kind", "name"), [("project", "gaits"), ("user", "ann")])
def test_of_many_who_submit_at_once_exactly_as_many_as_the_quota_says_are_added(
    jobs: JobStore, kind: str, name: str
) -> None:
    limit(jobs, kind, name, queued=5)
    new = [of(queued_job(number)) for number in range(12)]
    assert sum(at_once([partial(jobs.add, job) for job in new], QuotaExceeded)) == 5
    assert used(jobs).use.queued == 5
    with pytest.raises(
        QuotaExceeded, match=rf"The {kind} {name} has 5 jobs in the queue, and its quota is 5"
    ):
        jobs.add(of(queued_job(20)))
    jobs.add(of(queued_job(21), owner="ben", project="legs"))  # Another's.


def test_a_job_that_a_key_has_added_is_found_again_though_no_other_may_be_added(jobs: JobStore) -> None:
    limit(jobs, queued=1)
    first = jobs.add(of(queued_job()), Idempotency("k", "body"))
    assert jobs.add(of(queued_job(1)), Idempotency("k", "body")) == first


def test_a_job_that_waits_again_is_never_refused(jobs: JobStore) -> None:
    job = jobs.add(of(queued_job()))
    jobs.save(claimed := job.claimed("worker-1", utc_now()), lease=LEASE)
    limit(jobs, queued=0)
    jobs.save(claimed.requeued(Reason.WORKER_LOST, "", utc_now()))
    assert (used(jobs).use.queued, used(jobs).use.running) == (1, 0)


def test_a_trial_counts_as_any_job_does(job_store: PostgresJobStore) -> None:
    sweep = job_store.add_sweep(sweep_of())
    limit(job_store, name="default", queued=1)
    jobs = [queued_job(number) for number in range(2)]
    job_store.add_trial(sweep.id, trial_of(0, job=jobs[0].id), jobs[0])
    with pytest.raises(QuotaExceeded):
        job_store.add_trial(sweep.id, trial_of(1, job=jobs[1].id), jobs[1])
    assert len(job_store.trials([sweep.id])[sweep.id]) == 1


def test_gpu_hours_are_those_of_seven_days_with_what_runs_now(jobs: JobStore, database: Database) -> None:
    """Two GPUs for 90 s seven days ago and for 60 s now, and one that has run for 30 s: 2 x 60 + 30 = 150."""
    limit(jobs, gpu_hours=1)
    ran(jobs, of(queued_job()), timedelta(seconds=90))
    database.change("UPDATE usage SET hour = hour - interval '7 days 1 hour'")
    ran(jobs, of(queued_job(1), owner="ben"), timedelta(seconds=60))
    ran(jobs, of(queued_job(2)), timedelta(hours=2), "node1:cpu:a1b2c3")
    ran(jobs, of(queued_job(3), project="legs"), timedelta(hours=2))
    running = jobs.add(of(queued_job(4)))
    jobs.save(running.claimed("node1:gpu:0:a1b2c3", utc_now() - timedelta(seconds=30)), lease=LEASE)
    assert used(jobs).use.running == 1
    for whose in (None, ANN):
        (found,) = jobs.quota_uses(whose)
        assert sum(found.use.gpu_hours.values()) * 3600 == pytest.approx(150, abs=5)
    limit(jobs, "user", "ann", gpu_hours=1)
    hours = {found.whose: sum(found.use.gpu_hours.values()) for found in jobs.quota_uses(ANN)}
    assert hours["user ann"] == pytest.approx((2 * 7200 + 30) / 3600, abs=0.01)


def test_bytes_are_those_of_files_of_jobs_and_of_models_that_are_there(jobs: JobStore) -> None:
    limit(jobs, bytes=100)
    job = jobs.add(of(queued_job()))
    jobs.save(claimed := job.claimed("worker-1", utc_now()), lease=LEASE)
    jobs.save(kept := claimed.with_artifacts((artifact("a", size=30), artifact("b", size=12))))
    jobs.add(of(queued_job(1)).with_artifacts((artifact("c", size=5),)))
    jobs.models.add(model(size=7))
    jobs.models.claim(MODEL, ANN)
    assert used(jobs).use.bytes == 30 + 12 + 5 + 7
    jobs.save(fewer := kept.without_artifacts(kept.artifacts[:1]))
    (found,) = jobs.quota_uses(ANN, ["bytes"])
    assert found.use.bytes == 12 + 5 + 7
    (both,) = jobs.usage(utc_now()).projects
    assert (both.project, both.owner, both.bytes) == ("gaits", "ann", 24)
    ended = fewer.requeued(Reason.WORKER_LOST, "", utc_now())
    jobs.save(ended)
    jobs.delete(ended.id, ended.version)
    jobs.models.release(MODEL, ["gaits"])
    assert used(jobs).use.bytes == 5


def test_only_the_parts_that_are_limited_are_read_for_a_submission(jobs: JobStore) -> None:
    limit(jobs, queued=9)
    limit(jobs, "user", "ben", queued=9)
    jobs.add(of(queued_job()).with_artifacts((artifact("a", size=30),)))
    assert [found.use.bytes for found in jobs.quota_uses(ANN)] == [0]
    assert jobs.quota_uses(Ownership(None, "default")) == []
