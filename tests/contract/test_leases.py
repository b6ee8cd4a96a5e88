"""What the record promises of leases, of taking jobs back, and of what is to be dispatched."""

import time
from collections.abc import Callable
from datetime import timedelta
from functools import partial

import pytest

from core.errors import JobExists, JobNotFound, LeaseLost, StaleJob
from core.jobs.job import Job, new_job_id
from core.jobs.queue import MODELS
from core.jobs.status import JobStatus
from core.jobs.store import Dispatch, JobStore
from core.reasons import Reason
from tests.contract.recording import (
    LEASE,
    MODEL,
    NOW,
    Database,
    at_once,
    cancelled,
    held,
    model,
    queued_job,
    statuses,
    taken_back,
    watch,
)


class TestLeases:
    def test_a_claim_starts_a_lease(self, jobs: JobStore, database: Database) -> None:
        claimed = held(jobs, queued_job())
        watch(jobs, database)
        assert list(jobs.expired()) == []
        database.end_lease(claimed)
        assert list(jobs.expired()) == [claimed]

    @pytest.mark.parametrize("comes", ["a claim", "a cancel"])
    @pytest.mark.parametrize("attempts_before", [0, 1])
    def test_who_knows_a_lost_claim_changes_nothing_of_what_came_in_its_place(
        self, jobs: JobStore, comes: str, attempts_before: int
    ) -> None:
        job = queued_job()
        if attempts_before:
            job = taken_back(held(jobs, job))
            jobs.save(job)
        else:
            jobs.add(job)
        lost = job.claimed("worker-2", NOW)
        came = job.claimed("worker-3", NOW) if comes == "a claim" else cancelled(job)
        jobs.save(came)
        assert came.version == lost.version
        for stale in (
            lost.noted(device="cpu"),
            lost.running(device="cpu"),
            lost.become(JobStatus.CANCELLING),
            lost.requeued(Reason.WORKER_DRAINED, "Shut down.", NOW),
            lost.ended(JobStatus.SUCCEEDED, Reason.COMPLETED, "Done.", NOW),
        ):
            with pytest.raises(StaleJob):
                jobs.save(stale)
        assert jobs.get(job.id) == came

    def test_a_lease_ends_by_the_clock_of_the_store(self, jobs: JobStore, database: Database) -> None:
        job = queued_job()
        jobs.add(job)
        claimed = job.claimed("worker-1", NOW)
        jobs.save(claimed, lease=timedelta(0))
        watch(jobs, database)
        until = time.monotonic() + 10
        while not list(jobs.expired()) and time.monotonic() < until:
            pass
        assert list(jobs.expired()) == [claimed]

    def test_a_queued_job_has_no_lease(self, jobs: JobStore, database: Database) -> None:
        jobs.add(queued_job())
        watch(jobs, database)
        assert list(jobs.expired()) == []

    def test_a_renewed_lease_goes_on_also_after_its_end(self, jobs: JobStore, database: Database) -> None:
        # After an outage of the store the attempt that went on working is still the one that holds the job.
        claimed = held(jobs, queued_job())
        watch(jobs, database)
        database.end_lease(claimed)
        assert jobs.renew(claimed.id, claimed.token, LEASE).status == JobStatus.STARTING
        assert list(jobs.expired()) == []

    def test_renewing_tells_of_a_cancel(self, jobs: JobStore, database: Database) -> None:
        running = held(jobs, queued_job()).running()
        jobs.save(running)
        jobs.save(running.become(JobStatus.CANCELLING))
        watch(jobs, database)
        database.end_lease(running)
        assert jobs.renew(running.id, running.token, LEASE).status == JobStatus.CANCELLING
        assert list(jobs.expired()) == []

    def test_renewing_moves_no_version(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        jobs.renew(claimed.id, claimed.token, LEASE)
        assert jobs.get(claimed.id) == claimed

    def test_a_step_of_its_own_attempt_keeps_the_lease(self, jobs: JobStore, database: Database) -> None:
        claimed = held(jobs, queued_job())
        jobs.save(claimed.running())
        watch(jobs, database)
        assert list(jobs.expired()) == []

    @pytest.mark.parametrize("token", ["", "1-0000000000000000"])
    def test_another_token_renews_nothing(self, jobs: JobStore, database: Database, token: str) -> None:
        claimed = held(jobs, queued_job())
        watch(jobs, database)
        database.end_lease(claimed)
        with pytest.raises(LeaseLost):
            jobs.renew(claimed.id, token, LEASE)
        assert list(jobs.expired()) == [claimed]

    @pytest.mark.parametrize("token", ["", "1-0000000000000000"])
    def test_nobody_renews_a_job_that_nobody_holds(self, jobs: JobStore, token: str) -> None:
        job = queued_job()
        jobs.add(job)
        with pytest.raises(LeaseLost):
            jobs.renew(job.id, token, LEASE)
        with pytest.raises(LeaseLost):
            jobs.renew(new_job_id(NOW), token, LEASE)

    def test_a_job_that_left_its_attempt_has_no_lease(self, jobs: JobStore, database: Database) -> None:
        claimed = held(jobs, queued_job())
        jobs.save(taken_back(claimed))
        watch(jobs, database)
        assert list(jobs.expired()) == []
        with pytest.raises(LeaseLost):
            jobs.renew(claimed.id, claimed.token, LEASE)

    def test_the_lease_of_one_attempt_is_not_the_next_ones(self, jobs: JobStore, database: Database) -> None:
        requeued = taken_back(held(jobs, queued_job()))
        jobs.save(requeued)
        again = requeued.claimed("worker-2", NOW)
        jobs.save(again)
        watch(jobs, database)
        assert list(jobs.expired()) == [again]

    def test_every_held_job_whose_lease_is_over_is_found_oldest_first(
        self, jobs: JobStore, database: Database
    ) -> None:
        third, first, second, alive, ended = (held(jobs, queued_job(i)) for i in (3, 1, 2, 4, 5))
        running = second.running()
        jobs.save(running)
        jobs.save(cancelling := third.become(JobStatus.CANCELLING))
        jobs.save(ended.ended(JobStatus.FAILED, Reason.DIVERGED, "", NOW))
        for job in (first, second, third):
            database.end_lease(job)
        watch(jobs, database)
        assert list(jobs.expired()) == [first, running, cancelling]
        assert jobs.get(alive.id) == alive


class TestTakingBack:
    def test_a_job_whose_lease_is_over_is_taken_back(self, jobs: JobStore, database: Database) -> None:
        claimed = held(jobs, queued_job())
        watch(jobs, database)
        database.end_lease(claimed)
        taken = taken_back(claimed)
        jobs.take_back(taken)
        assert jobs.get(claimed.id) == taken
        assert jobs.undispatched() == [Dispatch("attempt", claimed.id, 2)]
        assert statuses(jobs, claimed)[-1].data["status"] == "queued"
        with pytest.raises(LeaseLost):
            jobs.renew(claimed.id, claimed.token, LEASE)

    def test_a_lease_renewed_after_the_look_keeps_the_job(self, jobs: JobStore, database: Database) -> None:
        claimed = held(jobs, queued_job())
        watch(jobs, database)
        database.end_lease(claimed)
        (found,) = jobs.expired()
        jobs.renew(claimed.id, claimed.token, LEASE)
        with pytest.raises(StaleJob):
            jobs.take_back(taken_back(found))
        assert jobs.get(claimed.id) == claimed
        assert jobs.undispatched() == []
        assert jobs.renew(claimed.id, claimed.token, LEASE).status == JobStatus.STARTING

    def test_an_older_version_takes_nothing_back(self, jobs: JobStore, database: Database) -> None:
        claimed = held(jobs, queued_job())
        jobs.save(cancelling := claimed.become(JobStatus.CANCELLING))
        watch(jobs, database)
        database.end_lease(claimed)
        with pytest.raises(StaleJob):
            jobs.take_back(taken_back(claimed))
        assert jobs.get(claimed.id) == cancelling

    def test_taking_back_an_unknown_job_is_not_found(self, jobs: JobStore) -> None:
        with pytest.raises(JobNotFound):
            jobs.take_back(taken_back(queued_job().claimed("worker-1", NOW)))

    def test_of_many_that_take_a_job_back_at_once_one_wins(self, jobs: JobStore, database: Database) -> None:
        claimed = held(jobs, queued_job())
        watch(jobs, database)
        database.end_lease(claimed)
        taken = taken_back(claimed)
        won = at_once([partial(jobs.take_back, taken)] * 8, StaleJob)
        assert won.count(True) == 1
        assert jobs.get(claimed.id) == taken
        assert [entry.data["status"] for entry in statuses(jobs, claimed)] == ["starting", "queued"]

    def test_of_an_attempt_that_renews_and_one_that_takes_its_job_one_wins(
        self, jobs: JobStore, database: Database
    ) -> None:
        watch(jobs, database)
        for i in range(20):
            claimed = held(jobs, queued_job(i))
            database.end_lease(claimed)
            taken = taken_back(claimed)

            def take_back(taken: Job = taken) -> None:
                try:
                    jobs.take_back(taken)
                except StaleJob:
                    raise LeaseLost(taken.id) from None

            steps = [partial(jobs.renew, claimed.id, claimed.token, LEASE), take_back]
            renewed, was_taken = at_once(steps, LeaseLost)
            assert renewed != was_taken
            assert jobs.get(claimed.id) == (claimed if renewed else taken)


class TestPulse:
    """Leases are watched with patience."""

    @pytest.fixture
    def silent(self, jobs: JobStore, database: Database) -> Job:
        """A job whose lease is over, in a record that has been watched."""
        claimed = held(jobs, queued_job())
        watch(jobs, database)
        database.end_lease(claimed)
        return claimed

    def test_a_beat_in_time_changes_nothing(self, jobs: JobStore, database: Database, silent: Job) -> None:
        database.pass_time(0.4 * LEASE)
        jobs.beat(LEASE)
        assert list(jobs.expired()) == [silent]

    def test_after_a_silence_nobody_is_taken_back_for_a_whole_lease(
        self, jobs: JobStore, database: Database, silent: Job
    ) -> None:
        database.pass_time(0.6 * LEASE)
        for _ in range(4):  # At 0, 0.3, 0.6 and 0.9 of a lease after the first beat.
            jobs.beat(LEASE)
            assert list(jobs.expired()) == []
            with pytest.raises(StaleJob):
                jobs.take_back(taken_back(silent))
            database.pass_time(0.3 * LEASE)
        jobs.beat(LEASE)
        assert list(jobs.expired()) == [silent]
        jobs.take_back(taken_back(silent))

    def test_in_that_time_an_attempt_renews_its_lease(
        self, jobs: JobStore, database: Database, silent: Job
    ) -> None:
        database.pass_time(10 * LEASE)
        jobs.beat(LEASE)
        jobs.renew(silent.id, silent.token, 2 * LEASE)
        for _ in range(4):
            database.pass_time(0.3 * LEASE)
            jobs.beat(LEASE)
        assert list(jobs.expired()) == []

    def test_nobody_is_taken_back_by_a_look_long_after_the_last_beat(
        self, jobs: JobStore, database: Database, silent: Job
    ) -> None:
        # The store was away between the beat and the look: no attempt could renew its lease.
        database.pass_time(0.6 * LEASE)
        assert list(jobs.expired()) == []
        with pytest.raises(StaleJob):
            jobs.take_back(taken_back(silent))

    def test_a_new_record_takes_nobody_back_before_it_was_watched_for_a_lease(
        self, jobs: JobStore, database: Database
    ) -> None:
        claimed = held(jobs, queued_job())
        database.end_lease(claimed)
        assert list(jobs.expired()) == []
        database.change("UPDATE pulse SET beat_at = now() - interval '1 year'")
        jobs.beat(LEASE)
        assert list(jobs.expired()) == []

    def test_a_clock_set_forward_ends_no_lease(self, jobs: JobStore, database: Database) -> None:
        held(jobs, queued_job())
        watch(jobs, database)
        database.pass_time(timedelta(hours=1))
        jobs.beat(LEASE)
        assert list(jobs.expired()) == []

    def test_a_clock_set_back_prolongs_no_lease_beyond_one_from_now(
        self, jobs: JobStore, database: Database
    ) -> None:
        claimed = held(jobs, queued_job())
        watch(jobs, database)
        database.pass_time(-timedelta(hours=1))
        jobs.beat(LEASE)
        assert list(jobs.expired()) == []
        # Without the beat's correction its lease would last for another hour.
        for _ in range(4):
            database.pass_time(0.3 * LEASE)
            jobs.beat(LEASE)
        assert list(jobs.expired()) == [claimed]

    def test_a_lease_longer_than_the_reconcilers_stays(self, jobs: JobStore, database: Database) -> None:
        claimed = held(jobs, queued_job())
        jobs.renew(claimed.id, claimed.token, 3 * LEASE)
        watch(jobs, database)
        for _ in range(5):  # 1.5 leases.
            database.pass_time(0.3 * LEASE)
            jobs.beat(LEASE)
        assert list(jobs.expired()) == []


class TestDispatches:
    def test_a_new_job_is_to_be_dispatched_until_it_was(self, jobs: JobStore) -> None:
        job = queued_job()
        jobs.add(job)
        (dispatch,) = jobs.undispatched()
        assert dispatch == Dispatch("attempt", job.id, 1)
        jobs.dispatched([dispatch])
        assert jobs.undispatched() == []
        jobs.dispatched([dispatch])

    def test_a_requeued_job_is_to_be_dispatched_with_its_next_attempt(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        assert jobs.undispatched() == []
        jobs.save(taken_back(claimed))
        assert jobs.undispatched() == [Dispatch("attempt", claimed.id, 2)]

    @pytest.mark.parametrize("step", [lambda job: job.claimed("worker-1", NOW), cancelled])
    def test_a_job_that_left_the_queue_is_not_to_be_dispatched(
        self, jobs: JobStore, step: Callable[[Job], Job]
    ) -> None:
        job = queued_job()
        jobs.add(job)
        jobs.save(step(job))
        assert (jobs.undispatched(), jobs.waiting()) == ([], [])

    def test_a_deleted_job_is_not_to_be_dispatched(self, jobs: JobStore) -> None:
        job, other = queued_job(), queued_job(1)
        jobs.add(job)
        jobs.add(other)
        jobs.delete(job.id, job.version)
        assert jobs.undispatched() == jobs.waiting() == [Dispatch("attempt", other.id, 1)]

    def test_word_of_an_earlier_attempt_leaves_the_next_one_to_be_dispatched(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        jobs.save(taken_back(claimed))
        jobs.dispatched([Dispatch("attempt", claimed.id, 1)])
        assert jobs.undispatched() == [Dispatch("attempt", claimed.id, 2)]

    def test_a_refused_write_leaves_nothing_to_be_dispatched(self, jobs: JobStore) -> None:
        claimed = held(jobs, queued_job())
        with pytest.raises(JobExists):
            jobs.add(claimed.model_copy(update={"status": JobStatus.QUEUED}))
        with pytest.raises(StaleJob):
            jobs.save(taken_back(claimed).next())
        assert jobs.undispatched() == []

    def test_what_was_stored_first_is_dispatched_first(self, jobs: JobStore) -> None:
        added = [queued_job(i) for i in (2, 0, 1)]
        for job in added:
            jobs.add(job)
        assert [dispatch.subject for dispatch in jobs.undispatched()] == [job.id for job in added]

    def test_of_what_waits_each_queue_gets_its_oldest_as_far_as_it_has_room(self, jobs: JobStore) -> None:
        """H4: the most urgent queue first, and without those that are left out."""
        normal = [jobs.add(queued_job(i)) for i in range(4)]
        urgent = [jobs.add(queued_job(i, priority="high")) for i in (4, 5)]
        room = {"gaitway-any-high": 1, "gaitway-any-normal": 2, "gaitway-cpu-low": 9}
        found = jobs.waiting(room, {(normal[0].id, 1), (normal[2].id, 2)})
        assert [dispatch.subject for dispatch in found] == [urgent[0].id, normal[1].id, normal[2].id]

    def test_a_job_whose_queue_is_not_recorded_is_found(self, jobs: JobStore, database: Database) -> None:
        """H4: an older version wrote it."""
        job = jobs.add(queued_job())
        database.change("UPDATE jobs SET queue = NULL")
        assert jobs.waiting() == [Dispatch("attempt", job.id, 1)]

    def test_what_waits_is_found_whether_it_was_dispatched_or_not(self, jobs: JobStore) -> None:
        told, untold, taken, ended = (queued_job(i) for i in range(4))
        for job in (told, untold, ended):
            jobs.add(job)
        jobs.save(taken_back(held(jobs, taken)))
        jobs.save(cancelled(ended))
        held(jobs, queued_job(4))
        jobs.dispatched([Dispatch("attempt", told.id, 1)])
        jobs.models.add(model(status="validating"))
        jobs.models.dispatched(MODEL)
        jobs.models.add(model(MODEL.replace("0", "1")))
        assert jobs.waiting() == [
            Dispatch("attempt", told.id, 1),
            Dispatch("attempt", untold.id, 1),
            Dispatch("attempt", taken.id, 2),
            Dispatch("model", MODEL),
        ]


def test_a_record_whose_tables_were_emptied_is_watched_again(jobs: JobStore, database: Database) -> None:
    database.change("DELETE FROM pulse")
    claimed = held(jobs, queued_job())
    jobs.beat(LEASE)
    jobs.ping()
    watch(jobs, database)
    database.end_lease(claimed)
    assert list(jobs.expired()) == [claimed]


class TestCounts:
    def test_what_may_begin_and_what_is_held_counts_by_queue(self, jobs: JobStore) -> None:
        gpu = {"resources": {"gpus": 2}}
        for at_s, said in enumerate(({}, gpu, {**gpu, "priority": "high"})):
            jobs.add(queued_job(at_s, **said))
        held(jobs, queued_job(10))
        jobs.add(cancelled(queued_job(11)))
        later = held(jobs, queued_job(12, resources={"accelerator": "cpu"}))
        paused = later.requeued(Reason.NATIVE_CRASH, "", NOW, not_before=jobs.now() + timedelta(minutes=1))
        jobs.save(paused)
        jobs.models.add(model(status="validating"))
        counts = {one.queue: (one.queued, one.running) for one in jobs.queue_counts()}
        assert counts == {
            "gaitway-any-normal": (1, 1),
            "gaitway-gpu2-normal": (1, 0),
            "gaitway-gpu2-high": (1, 0),
            MODELS: (1, 0),
        }

    def test_a_job_that_was_given_back_waits_since_then(self, jobs: JobStore) -> None:
        first, second = held(jobs, queued_job()), queued_job(resources={"accelerator": "cpu"})
        jobs.save(first.requeued(Reason.WORKER_DRAINED, "", jobs.now() - timedelta(seconds=30)))
        jobs.add(second)
        ages = {one.queue: one.oldest_queued_s or 0 for one in jobs.queue_counts()}
        assert 30 <= ages["gaitway-any-normal"] < 60
        assert ages["gaitway-cpu-normal"] >= (jobs.now() - second.created_at).total_seconds() - 60
