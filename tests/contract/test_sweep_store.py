"""What the record promises of sweeps and their trials."""

import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta

import pytest

from core.errors import IdempotencyKeyReused, Rejected, StaleSweep, SweepNotFound
from core.jobs.job import new_job_id
from core.jobs.store import Dispatch, Idempotency
from core.sweeps.sweep import Sweep, SweepStatus, SweepStore
from tests.contract.recording import NOW, Database, at_once, queued_job
from tests.unit.sweeps.making import sweep_of, trial_of


@pytest.fixture
def sweeps(jobs: SweepStore) -> SweepStore:
    """Each record in turn, empty."""
    return jobs


@pytest.fixture
def sweep(sweeps: SweepStore) -> Sweep:
    return sweeps.add_sweep(sweep_of())


def sent(sweeps: SweepStore, ago: timedelta = timedelta()) -> Sweep:
    """A sweep that is sent now, or was."""
    now = sweeps.now() - ago
    return sweep_of().model_copy(update={"id": new_job_id(now), "created_at": now})


class TestSweeps:
    def test_what_was_added_is_read_back_equal(self, sweeps: SweepStore) -> None:
        sweep = sweep_of(
            name="erste – 初 🐜",
            parameters={
                "algorithm.learning_rate": {"low": 0.0, "high": 1.0, "points": 3},
                "algorithm.policy_hidden_layer_sizes": [[32, 32], [64]],
                "seed": {"low": 1, "high": 3, "step": 1},
            },
            objective=[{"metric": "a"}, {"metric": "b", "direction": "minimize"}],
            pruning={"kind": "hyperband", "min_steps": 100},
            population={"size": 4, "generations": 3, "perturbation_factors": [0.5, 2.0]},
        )
        assert sweeps.add_sweep(sweep) == sweep
        assert sweeps.get_sweep(sweep.id) == sweep
        found = sweep.next(
            status=SweepStatus.SUCCEEDED,
            message="All done.",
            finished_at=NOW,
            importance={"a": {"seed": 0.25}},
            num_judged=4,
        )
        sweeps.save_sweep(found)
        assert sweeps.get_sweep(sweep.id) == found
        assert list(sweeps.list_sweeps().sweeps) == [found]

    def test_an_unknown_sweep_is_not_found(self, sweeps: SweepStore) -> None:
        for step in (
            sweeps.get_sweep,
            lambda sweep_id: sweeps.delete_sweep(sweep_id, 1),
            lambda sweep_id: sweeps.save_sweep(sweep_of().next()),
        ):
            with pytest.raises(SweepNotFound):
                step(new_job_id(NOW))

    def test_a_stale_save_is_refused_and_changes_nothing(self, sweeps: SweepStore, sweep: Sweep) -> None:
        sweeps.save_sweep(newer := sweep.next(message="first"))
        for stale in (lambda: sweeps.save_sweep(sweep.next()), lambda: sweeps.delete_sweep(sweep.id, 1)):
            with pytest.raises(StaleSweep):
                stale()
        assert sweeps.get_sweep(sweep.id) == newer

    def test_one_key_makes_one_sweep_however_many_send_it(self, sweeps: SweepStore) -> None:
        together, key = threading.Barrier(4), Idempotency("k", "body")

        def submit(number: int) -> str:
            together.wait()
            return sweeps.add_sweep(sent(sweeps), key).id

        with ThreadPoolExecutor(4) as pool:
            assert len(set(pool.map(submit, range(4)))) == 1
        assert len(sweeps.list_sweeps().sweeps) == 1
        with pytest.raises(IdempotencyKeyReused):
            sweeps.add_sweep(sent(sweeps), Idempotency("k", "another body"))

    def test_a_key_is_remembered_for_a_day(self, sweeps: SweepStore) -> None:
        """L4: it was remembered for ever, though the header says 24 hours."""
        long_ago = sent(sweeps, timedelta(hours=24, seconds=1))
        lately = sent(sweeps, timedelta(hours=23, minutes=59))
        assert sweeps.add_sweep(long_ago, Idempotency("a", "body")) == long_ago
        assert sweeps.add_sweep(lately, Idempotency("b", "body")) == lately
        again, other = sent(sweeps), sent(sweeps)
        assert sweeps.add_sweep(again, Idempotency("a", "another body")) == again
        assert sweeps.add_sweep(other, Idempotency("b", "body")).id == lately.id
        sweeps.delete_sweep(lately.id, lately.version)
        assert sweeps.add_sweep(other, Idempotency("b", "body")) == other

    def test_pages_are_newest_first_and_without_gap(self, sweeps: SweepStore) -> None:
        ids = [
            sweeps.add_sweep(sweep_of().model_copy(update={"id": f"{n:012x}-0000000000"})).id
            for n in range(5)
        ]
        sweeps.save_sweep(sweeps.get_sweep(ids[2]).next(status=SweepStatus.FAILED))
        found, cursor = list[str](), None
        while True:
            page = sweeps.list_sweeps(cursor=cursor, limit=2)
            found += [sweep.id for sweep in page.sweeps]
            if (cursor := page.next_cursor) is None:
                break
        assert found == ids[::-1]
        assert [one.id for one in sweeps.list_sweeps(status=SweepStatus.FAILED).sweeps] == [ids[2]]
        assert [one.id for one in sweeps.active_sweeps()] == [*ids[:2], *ids[3:]]
        with pytest.raises(Rejected):
            sweeps.list_sweeps(cursor="nonsense")

    def test_one_that_another_version_wrote_does_not_stop_the_others(
        self, sweeps: SweepStore, sweep: Sweep, database: Database
    ) -> None:
        other = sweeps.add_sweep(sweep_of())
        database.change('UPDATE sweeps SET spec = \'{"method": "of tomorrow"}\' WHERE id = %s', sweep.id)
        assert [one.id for one in sweeps.active_sweeps()] == [other.id]
        assert [one.id for one in sweeps.list_sweeps().sweeps] == [other.id]


class TestTrials:
    def test_a_trial_its_job_and_its_dispatch_are_stored_together(
        self, sweeps: SweepStore, sweep: Sweep
    ) -> None:
        job = queued_job()
        trial = trial_of(0, job=job.id, parameters={"seed": 1, "a": [1, None], "b": 0.5}, values=(1.5, None))
        assert sweeps.add_trial(sweep.id, trial, job)
        assert sweeps.trials([sweep.id]) == {sweep.id: [trial]}
        assert sweeps.jobs_of([job.id, "unknown"]) == {job.id: job}
        assert sweeps.undispatched() == [Dispatch("attempt", job.id, 1)]

    def test_the_lineage_of_a_trial_is_kept_and_older_records_have_none(
        self, sweeps: SweepStore, sweep: Sweep, database: Database
    ) -> None:
        first = trial_of(0, job=None)
        second = trial_of(1, job=None, parent=0, inherited_steps=700)
        for trial in (first, second):
            sweeps.add_trial(sweep.id, trial, None)
        assert sweeps.trials([sweep.id])[sweep.id] == [first, second]
        elsewhere = {"number", "job", "outcome", "created_at"}
        older = first.model_dump_json(exclude={*elsewhere, "parent", "inherited_steps"})
        database.change("UPDATE trials SET document = %s WHERE number = 0", older)
        assert sweeps.trials([sweep.id])[sweep.id] == [first, second]

    def test_a_number_begins_once_however_many_start_it(self, sweeps: SweepStore, sweep: Sweep) -> None:
        jobs = [queued_job() for _ in range(4)]
        together = threading.Barrier(4)

        def start(number: int) -> bool:
            together.wait()
            return sweeps.add_trial(sweep.id, trial_of(0, job=jobs[number].id), jobs[number])

        with ThreadPoolExecutor(4) as pool:
            assert sorted(pool.map(start, range(4))) == [False, False, False, True]
        [trial] = sweeps.trials([sweep.id])[sweep.id]
        assert list(sweeps.jobs_of([job.id for job in jobs])) == [trial.job]
        assert [dispatch.subject for dispatch in sweeps.undispatched()] == [trial.job]

    def test_none_starts_once_the_sweep_is_cancelled(self, sweeps: SweepStore, sweep: Sweep) -> None:
        sweeps.save_sweep(sweep.next(status=SweepStatus.CANCELLING))
        job = queued_job()
        assert not sweeps.add_trial(sweep.id, trial_of(0, job=job.id), job)
        assert not sweeps.add_trial(new_job_id(NOW), trial_of(0, job=job.id), job)
        assert sweeps.jobs_of([job.id]) == {}

    def test_a_cancel_and_a_start_at_once_leave_a_job_only_with_its_trial(self, sweeps: SweepStore) -> None:
        for _ in range(10):
            sweep, job = sweeps.add_sweep(sweep_of()), queued_job()
            trial, cancelling = trial_of(0, job=job.id), sweep.next(status=SweepStatus.CANCELLING)
            steps = [
                lambda s=sweep, t=trial, j=job: sweeps.add_trial(s.id, t, j),
                lambda c=cancelling: sweeps.save_sweep(c),
            ]
            assert at_once(steps, StaleSweep) == [True, True]
            assert len(sweeps.jobs_of([job.id])) == len(sweeps.trials([sweep.id]).get(sweep.id, []))

    def test_an_outcome_is_stored_once(self, sweeps: SweepStore, sweep: Sweep) -> None:
        sweeps.add_trial(sweep.id, trial := trial_of(0, job=None), None)
        pruned = trial.model_copy(update={"is_pruned": True})
        assert sweeps.save_trial(sweep.id, pruned)
        ended = pruned.model_copy(update={"outcome": "pruned", "steps": 7, "values": (1.0,)})
        assert sweeps.save_trial(sweep.id, ended)
        assert not sweeps.save_trial(sweep.id, ended.model_copy(update={"outcome": "failed"}))
        assert not sweeps.save_trial(sweep.id, trial_of(1))
        assert sweeps.trials([sweep.id])[sweep.id] == [ended]

    def test_a_deleted_job_leaves_its_trial_and_a_deleted_sweep_leaves_its_jobs(
        self, sweeps: SweepStore, sweep: Sweep
    ) -> None:
        jobs = [queued_job(), queued_job()]
        for number, job in enumerate(jobs):
            sweeps.add_trial(sweep.id, trial_of(number, job=job.id), job)
        sweeps.delete(jobs[0].id, 1)
        assert [trial.job for trial in sweeps.trials([sweep.id])[sweep.id]] == [None, jobs[1].id]
        sweeps.delete_sweep(sweep.id, 1)
        assert sweeps.trials([sweep.id]) == {}
        assert sweeps.get(jobs[1].id) == jobs[1]
