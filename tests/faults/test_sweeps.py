"""A sweep makes exactly its trials, whichever write fails, and however many reconcilers look."""

import itertools
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import timedelta
from typing import Any

import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.errors import TooManySweeps, Unavailable
from core.jobs.attempts import Claim, claim_attempt, new_secret
from core.jobs.job import Artifact, Job, Progress
from core.jobs.reconciliation import Reconciler
from core.jobs.status import JobStatus
from core.jobs.store import Entry, Idempotency, JobQuery
from core.reasons import Reason
from core.storage import keys
from core.sweeps.actions import cancel_sweep, resume_sweep, submit_sweep
from core.sweeps.controller import SweepController
from core.sweeps.spec import Budget, SweepSpec
from core.sweeps.sweep import SweepStatus
from tests.faults.crashing import Crash, Died, Failure, Process
from tests.in_memory import MemoryJobQueue, MemoryObjectStore
from tests.unit.sweeps.making import spec_of

LEASE = timedelta(minutes=5)
METRIC = "eval/episode_reward"
Train = Callable[[Process, Claim, Job], None]
# Two trials side by side, of which the second fails.
SPEC = spec_of(parameters={"seed": [1, 3]}, budget={"parallel": 2})
# Two members in two generations of one update each.
_ALGORITHM = {"num_timesteps": 200, "num_envs": 4, "batch_size": 4, "num_minibatches": 5, "unroll_length": 5}
POPULATION = spec_of(
    job={"kind": "train", "environment": "ant", "algorithm": _ALGORITHM, "seed": 3},
    method="pbt",
    parameters={"algorithm.learning_rate": {"low": 1e-4, "high": 1e-2}},
    population={"size": 2, "generations": 2},
)


class Reconcilers:
    """The process that moves the sweep on: after its death another one does, with nothing in memory.

    What it does for jobs meets no crash here: test_crash_points.py has those.
    """

    def __init__(self, real: Process, crash: Crash) -> None:
        self._real = real
        self._controller = self._of(real.crashing(crash))
        self._reconciler = Reconciler(real.store, real.queue, LEASE)

    @staticmethod
    def _of(it: Process) -> SweepController:
        return SweepController(it.store, it.queue, it.objects)

    def run_once(self) -> None:
        with suppress(Unavailable):  # The next look does it again.
            try:
                self._controller.run_once()
            except Died:
                self._controller = self._of(self._real)
        if self._real.store.undispatched():
            self._reconciler.run_once()


def train(real: Process, claim: Claim, job: Job) -> None:
    """A worker trains for 100 steps: the value of a trial is its seed, and 3 fails."""
    value = float(job.spec.seed)
    said = {"step": 100, "values": {METRIC: value}}
    entry = Entry(kind="metrics", time=real.store.now(), data=said)
    progress = Progress(step=100, total=1000, metrics={METRIC: value})
    real.store.record(job.id, claim.token, "events", [entry], progress, write_id=new_secret())
    if job.spec.seed == 3:
        claim.end(JobStatus.FAILED, Reason.DIVERGED, "NaN.")
    else:
        claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "All done.")


def train_member(real: Process, claim: Claim, job: Job) -> None:
    """A worker trains to the job's end and keeps a checkpoint: the first member is the better one."""
    step = job.spec.algorithm.num_timesteps
    artifact = Artifact(
        name=f"checkpoint-{step}",
        key=keys.artifact(job.id, claim.number, "0" * 64, "checkpoint"),
        size=0,
        sha256="0" * 64,
        role="checkpoint",
        media_type="application/octet-stream",
        step=step,
    )
    claim.publish((artifact,), 1)
    progress = Progress(step=step, total=step, metrics={METRIC: -float(job.spec.seed)})
    real.store.record(job.id, claim.token, "events", [], progress, write_id=new_secret())
    claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "All done.")


def claim_of(real: Process, dispatch: Any) -> Claim | None:
    return claim_attempt(
        dispatch.job_id,
        dispatch.attempt,
        "worker",
        store=real.store,
        objects=real.objects,
        lease=LEASE,
        secret=new_secret(),
    )


def work(real: Process, train: Train = train) -> bool:
    """A worker takes what waits and does it; False if nothing waits."""
    dispatch = real.queue.take()
    if dispatch is None:
        return False
    claim = claim_of(real, dispatch)
    real.queue.remove(dispatch.job_id, dispatch.attempt)
    if claim is None:
        return True
    claim.start(device="cpu")
    train(real, claim, real.store.get(dispatch.job_id))
    return True


def live(real: Process, crash: Crash, spec: SweepSpec = SPEC, train: Train = train) -> str:
    """A whole sweep; its id."""
    sweep = submit_sweep(spec, store=real.store)
    reconcilers = Reconcilers(real, crash)
    for _ in range(60):
        reconcilers.run_once()
        work(real, train)
        if real.store.get_sweep(sweep.id).status.is_final:
            return sweep.id
    raise AssertionError("The sweep does not come to its end.")


@pytest.fixture
def real(job_store: PostgresJobStore) -> Process:
    return Process(job_store, MemoryObjectStore(), MemoryJobQueue())


def check_exact(real: Process, sweep_id: str, num_trials: int) -> None:
    """Every trial once, with a job of its own, and no job besides."""
    sweep, trials = real.store.get_sweep(sweep_id), real.store.trials([sweep_id])[sweep_id]
    assert sweep.status == SweepStatus.SUCCEEDED
    assert [trial.number for trial in trials] == list(range(num_trials))
    assert len({str(trial.parameters) for trial in trials}) == num_trials
    jobs = real.store.list(JobQuery(labels={"sweep": sweep_id}), limit=200).jobs
    assert sorted(job.id for job in jobs) == sorted(trial.job for trial in trials)
    by_id = {job.id: job for job in jobs}
    for trial in trials:
        assert by_id[trial.job].spec.seed == trial.parameters["seed"]
        assert by_id[trial.job].spec.labels["trial"] == str(trial.number)


def test_every_trial_runs_once_whichever_write_fails(real: Process) -> None:
    live(real, counted := Crash())
    # Of each trial its start, its message, the message's receipt and its outcome; importance; the end.
    assert counted.num_writes == 10
    for failure, at in itertools.product(Failure, range(1, counted.num_writes + 1)):
        crash = Crash(at, failure)
        sweep_id = live(real, crash)
        check_exact(real, sweep_id, 2)
        trials = real.store.trials([sweep_id])[sweep_id]
        assert [trial.outcome for trial in trials] == ["succeeded", "failed"], (at, failure)
        assert [trial.values for trial in trials] == [(1.0,), (3.0,)]


@pytest.mark.extra
def test_a_population_trains_every_member_once_whichever_write_fails(real: Process) -> None:
    live(real, counted := Crash(), POPULATION, train_member)
    settings = set[str]()
    for failure, at in itertools.product(Failure, range(1, counted.num_writes + 1)):
        sweep_id = live(real, Crash(at, failure), POPULATION, train_member)
        trials = real.store.trials([sweep_id])[sweep_id]
        message = real.store.get_sweep(sweep_id).message
        assert message == "Every generation was trained: 4 succeeded.", (at, failure)
        assert [(trial.parent, trial.steps) for trial in trials] == [(None, 100)] * 2 + [(0, 100)] * 2
        assert trials[2].parameters == trials[0].parameters != trials[3].parameters
        settings.add(str([trial.parameters for trial in trials]))
        jobs = {job.id: job for job in real.store.list(JobQuery(labels={"sweep": sweep_id})).jobs}
        assert sorted(jobs) == sorted(trial.job for trial in trials)
        assert [jobs[trial.job].spec.seed for trial in trials] == [3, 4, 3, 4]
        assert {jobs[trial.job].spec.resume_from.job for trial in trials[2:]} == {trials[0].job}
    assert len(settings) == 1


@pytest.mark.extra
def test_reconcilers_side_by_side_start_every_trial_once(real: Process) -> None:
    spec = spec_of(parameters={"seed": list(range(12))}, budget={"parallel": 4})
    sweep = submit_sweep(spec, store=real.store)
    is_over, most = threading.Event(), 0

    def reconcile() -> None:
        controller = SweepController(real.store, real.queue, real.objects)
        while not is_over.wait(0.001):
            controller.run_once()

    with ThreadPoolExecutor(3) as pool:
        looking = [pool.submit(reconcile) for _ in range(2)]
        try:
            while not real.store.get_sweep(sweep.id).status.is_final:
                unfinished = [
                    one for one in real.store.trials([sweep.id]).get(sweep.id, []) if not one.outcome
                ]
                most = max(most, len(unfinished))
                work(real)
        finally:
            is_over.set()
        for one in looking:
            one.result(20)
    check_exact(real, sweep.id, 12)
    assert most <= 4


@pytest.mark.extra
def test_what_runs_is_pruned_and_keeps_its_values(real: Process) -> None:
    """The worker that has the job sees the cancel, as after a user's."""
    spec = spec_of(
        parameters={"seed": [5, 6, 1]},
        budget={"parallel": 1},
        pruning={"kind": "median", "startup_trials": 2},
    )
    sweep = submit_sweep(spec, store=real.store)
    reconcilers = Reconcilers(real, Crash())
    for _ in range(2):
        reconcilers.run_once()
        work(real)
    reconcilers.run_once()
    claim, job_id = claimed(real)
    entry = Entry(kind="metrics", time=real.store.now(), data={"step": 100, "values": {METRIC: 1.0}})
    progress = Progress(step=100, total=1000, metrics={METRIC: 1.0})
    real.store.record(job_id, claim.token, "events", [entry], progress, write_id="w")
    reconcilers.run_once()
    assert real.store.get(job_id).status == JobStatus.CANCELLING
    claim.end(JobStatus.CANCELLED, Reason.USER_CANCELLED, "It was cancelled.")
    reconcilers.run_once()
    reconcilers.run_once()
    last = real.store.trials([sweep.id])[sweep.id][-1]
    assert (last.outcome, last.values, last.steps) == ("pruned", (1.0,), 100)
    assert real.store.get_sweep(sweep.id).message == "Every combination was tried: 2 succeeded, 1 pruned."


def claimed(real: Process) -> Any:
    dispatch = real.queue.take()
    claim = claim_of(real, dispatch)
    assert claim is not None
    claim.start(device="cpu")
    return claim, dispatch.job_id


@pytest.mark.extra
def test_a_cancelled_sweep_ends_with_all_its_jobs_whichever_write_fails(real: Process) -> None:
    def cancelled(crash: Crash) -> str:
        sweep = submit_sweep(SPEC, store=real.store)
        Reconcilers(real, Crash()).run_once()
        cancel_sweep(sweep.id, store=real.store)
        reconcilers = Reconcilers(real, crash)
        for _ in range(20):
            if real.store.get_sweep(sweep.id).status.is_final:
                return sweep.id
            reconcilers.run_once()
        raise AssertionError("The sweep does not come to its end.")

    cancelled(counted := Crash())
    for failure, at in itertools.product(Failure, range(1, counted.num_writes + 1)):
        sweep_id = cancelled(Crash(at, failure))
        assert real.store.get_sweep(sweep_id).status == SweepStatus.CANCELLED
        jobs = real.store.list(JobQuery(labels={"sweep": sweep_id})).jobs
        assert {job.status for job in jobs} <= {JobStatus.CANCELLED}, (at, failure)
        assert len(jobs) == len(real.store.trials([sweep_id]).get(sweep_id, []))


def test_a_bug_in_one_sweep_stops_no_other(real: Process, monkeypatch: pytest.MonkeyPatch) -> None:
    bad, good = (submit_sweep(SPEC, store=real.store) for _ in range(2))
    add: Callable[..., bool] = real.store.add_trial

    def break_down(sweep_id: str, *rest: Any) -> bool:
        if sweep_id == bad.id:
            raise ZeroDivisionError
        return add(sweep_id, *rest)

    monkeypatch.setattr(real.store, "add_trial", break_down)
    with suppress(Unavailable):
        SweepController(real.store, real.queue, real.objects).run_once()
    assert list(real.store.trials([bad.id, good.id])) == [good.id]


@pytest.mark.extra
def test_a_sweep_for_which_nothing_has_changed_is_not_read_again(
    job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """M11: each look read each active sweep whole."""
    queue, objects = MemoryJobQueue(), MemoryObjectStore()
    sweep = submit_sweep(SPEC, store=job_store)
    controller = SweepController(job_store, queue, objects)
    read: list[list[str]] = []
    trials = job_store.trials

    def noted(sweep_ids: Any) -> Any:
        read.append(list(sweep_ids))
        return trials(sweep_ids)

    monkeypatch.setattr(job_store, "trials", noted)
    assert [controller.run_once() for _ in range(4)] == [2, 0, 0, 0]
    assert read == [[sweep.id], [sweep.id], [], []]
    dispatch = queue.take()
    assert dispatch is not None
    assert claim_of(Process(job_store, objects, queue), dispatch) is not None
    controller.run_once()
    assert read[4] == [sweep.id]
    another = SweepController(job_store, queue, objects)
    read.clear()
    cancel_sweep(sweep.id, store=job_store)
    for one in (controller, another):
        one.run_once()
    assert read == [[sweep.id]] * 2


@pytest.mark.extra
def test_the_curves_of_an_ended_sweep_are_forgotten(job_store: PostgresJobStore) -> None:
    """M11: the reconciler grew by the trials of every pruned sweep."""
    spec = spec_of(parameters={"seed": [1, 3]}, pruning={"kind": "median", "warmup_steps": 10})
    controller = SweepController(job_store, MemoryJobQueue(), MemoryObjectStore())
    sweep = submit_sweep(spec, store=job_store)
    controller.run_once()
    controller.run_once()
    assert list(controller._curves) == [sweep.id]
    cancel_sweep(sweep.id, store=job_store)
    for _ in range(3):
        controller.run_once()
    assert job_store.get_sweep(sweep.id).status == SweepStatus.CANCELLED
    assert (controller._curves, controller._settled) == ({}, {})


@pytest.mark.extra
def test_no_more_sweeps_run_than_the_reconciler_looks_at(
    job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """M11."""
    monkeypatch.setattr("core.sweeps.actions.MOST_ACTIVE", 2)
    spec = SPEC
    first = submit_sweep(spec, store=job_store, idempotency=(key := Idempotency("k", "body")))
    second = submit_sweep(spec, store=job_store)
    for refused in (None, Idempotency("other", "body")):
        with pytest.raises(TooManySweeps, match="2 sweeps, the maximum, are running"):
            submit_sweep(spec, store=job_store, idempotency=refused)
    assert submit_sweep(spec, store=job_store, idempotency=key) == first
    job_store.save_sweep(second.next(status=SweepStatus.CANCELLED))
    third = submit_sweep(spec, store=job_store, idempotency=Idempotency("other", "body"))
    with pytest.raises(TooManySweeps):
        resume_sweep(second.id, Budget(jobs=5), store=job_store)
    assert resume_sweep(third.id, Budget(jobs=5), store=job_store).id == third.id  # It runs already.
