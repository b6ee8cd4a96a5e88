"""Every write of a job's life fails once, in each way, and the job comes to the same end.

Each process of the service has its turn. How many writes it makes is counted first; then each of them is
refused, or loses its answer, or is the last thing that its process does. Those who are left go on: users send
again what was not answered, the reconciler looks, the next worker takes over.
"""

import hashlib
import itertools
import secrets
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import timedelta
from functools import partial
from typing import Any, Literal

import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.adapters.s3.objects import S3ObjectStore
from core.errors import JobNotFound, LeaseLost, Unavailable
from core.jobs import feeds, orphans
from core.jobs.attempts import Claim, claim_attempt, new_secret
from core.jobs.ending import cancel, delete, end_deletions
from core.jobs.job import Artifact, Job
from core.jobs.reconciliation import Reconciler
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.store import Entry, Idempotency, JobQuery
from core.jobs.submission import Acknowledgements, submit
from core.reasons import Reason
from core.storage import keys
from tests.contract.recording import Database
from tests.faults.crashing import Crash, Died, Failure, Process
from tests.feeds import read_feed
from tests.in_memory import Dispatch, MemoryJobQueue

LEASE = timedelta(minutes=5)
STEPS = (1, 2)
Role = Literal["api", "reconciler", "worker"]
ROLES: tuple[Role, ...] = ("api", "reconciler", "worker")


@dataclass
class Service:
    """The processes of a service, of which one meets the crash; the stores they share; and one job."""

    real: Process
    database: Database
    role: Role
    crash: Crash
    name: str = field(default_factory=lambda: secrets.token_hex(4))

    def __post_init__(self) -> None:
        self.processes = {role: self.real for role in ROLES}
        self.processes[self.role] = self.real.crashing(self.crash)
        self.reconciler = self._new_reconciler()

    def insist(self, role: Role, step: Callable[[Process], Any]) -> Any:
        """As often as it takes: after an outage the same process does it again, after a death another one."""
        while True:
            try:
                return step(self.processes[role])
            except Unavailable:
                continue
            except Died:
                self.processes[role] = self.real

    # ---- the API, for a user ------------------------------------------------------------------------

    def submit(self) -> str:
        spec = JOB_SPEC.validate_python(
            {"kind": "train", "environment": "ant", "name": self.name, "max_attempts": 5}
        )
        key = Idempotency(self.name, "the same body")
        job: Job = self.insist(
            "api",
            lambda it: submit(
                spec,
                store=it.store,
                queue=it.queue,
                idempotency=key,
                acknowledge=Acknowledgements(it.store.dispatched).add_at_once,
            ),
        )
        return job.id

    def cancel(self, job_id: str) -> None:
        self.insist("api", lambda it: cancel(job_id, store=it.store, queue=it.queue))

    def delete(self, job_id: str) -> None:
        with suppress(JobNotFound):  # The deletion that was not answered was done.
            self.insist("api", lambda it: delete(job_id, store=it.store, objects=it.objects))

    # ---- the reconciler -----------------------------------------------------------------------------

    def run_once(self, times: int = 1) -> None:
        """So often; and all else that it does."""
        for _ in range(times):
            try:
                self.reconciler.run_once()
            except Unavailable:
                self.reconciler.run_once()
            except Died:
                self.processes["reconciler"] = self.real
                self.reconciler = self._new_reconciler()
                self.reconciler.run_once()
        self.insist("reconciler", lambda it: feeds.compact(store=it.store, objects=it.objects))
        self.insist("reconciler", lambda it: it.store.tidy())
        at_once = timedelta(0)
        self.insist("reconciler", lambda it: end_deletions(store=it.store, objects=it.objects, after=at_once))

    def _new_reconciler(self) -> Reconciler:
        it = self.processes["reconciler"]
        return Reconciler(it.store, it.queue, LEASE)

    # ---- workers ------------------------------------------------------------------------------------

    def work(self, job_id: str, end: "End") -> None:
        """Workers take what is dispatched until the job has ended."""
        for _ in range(6):
            if self.real.store.get(job_id).status.is_final:
                return
            if (dispatch := self.real.queue.take()) is None:
                self._lease_passes(job_id)
                self.run_once(3)
                continue
            with suppress(LeaseLost):
                self._attempt(dispatch, end)
        raise AssertionError("The job does not come to its end.")

    def _attempt(self, dispatch: Dispatch, end: "End") -> None:
        it, crash = self.processes["worker"], self.crash
        through = partial(_through_outages, crash=crash)
        secret = new_secret()
        try:
            claim = through(lambda: _claim(it, dispatch, secret))
            if claim is None:
                return
            through(lambda: claim.start(device="cpu"))
            newest = it.store.get(dispatch.job_id).newest("checkpoint")
            for step in STEPS[0 if newest is None else newest.step :]:
                through(partial(_say, claim, step, secrets.token_hex(8)))
                through(partial(_publish, claim, step))
                through(lambda: claim.store.renew(claim.job_id, claim.token, LEASE))
            end(self, claim, through)
        except Died:  # Its lease runs out; somebody starts another one.
            self.processes["worker"] = self.real
        finally:
            self.real.queue.remove(dispatch.job_id, dispatch.attempt)

    def _lease_passes(self, job_id: str) -> None:
        self.database.change(
            "UPDATE jobs SET lease_until = now() - interval '1 s' WHERE id = %s AND token != ''", job_id
        )
        self.database.change("UPDATE pulse SET beat_at = now(), quiet_until = now() - interval '1 s'")


def _through_outages(step: Callable[[], Any], crash: Crash) -> Any:
    try:
        return step()
    except Unavailable:
        assert crash.has_happened
        return step()


def _claim(it: Process, dispatch: Dispatch, secret: str) -> Claim | None:
    return claim_attempt(
        dispatch.job_id,
        dispatch.attempt,
        "worker",
        store=it.store,
        objects=it.objects,
        lease=LEASE,
        secret=secret,
    )


def _say(claim: Claim, step: int, write_id: str) -> None:
    said = {"text": f"attempt {claim.number} step {step}"}
    entry = Entry(kind="line", time=claim.store.now(), data=said)
    claim.store.record(claim.job_id, claim.token, "logs", [entry], write_id=write_id)


def _publish(claim: Claim, step: int) -> None:
    body = f"checkpoint {step}".encode()
    digest = hashlib.sha256(body).hexdigest()
    name = f"checkpoint-{step}"
    key = keys.artifact(claim.job_id, claim.number, digest, name)
    claim.objects.put(key, body)
    artifact = Artifact(
        name=name,
        role="checkpoint",
        media_type="application/octet-stream",
        size=len(body),
        sha256=digest,
        key=key,
        step=step,
    )
    _, dropped = claim.publish((artifact,), 1)
    for old in dropped:
        claim.objects.delete_prefix(old)


# ---- how an attempt ends ----------------------------------------------------------------------------

End = Callable[[Service, Claim, Callable[[Callable[[], Any]], Any]], None]


def completes(service: Service, claim: Claim, through: Callable[[Callable[[], Any]], Any]) -> None:
    through(lambda: claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "All done."))


def is_cancelled(service: Service, claim: Claim, through: Callable[[Callable[[], Any]], Any]) -> None:
    service.cancel(claim.job_id)
    through(lambda: claim.end(JobStatus.CANCELLED, Reason.USER_CANCELLED, "Cancelled while it ran."))


def drains_at_first(service: Service, claim: Claim, through: Callable[[Callable[[], Any]], Any]) -> None:
    if claim.number == 1:
        through(lambda: claim.give_back(Reason.WORKER_DRAINED, "The worker was shut down."))
    else:
        completes(service, claim, through)


def is_silent_at_first(service: Service, claim: Claim, through: Callable[[Callable[[], Any]], Any]) -> None:
    if claim.number > 1:
        completes(service, claim, through)


# ---- lives ------------------------------------------------------------------------------------------


def _whole_life(service: Service, end: End) -> str:
    job_id = service.submit()
    service.work(job_id, end)
    service.run_once()
    return job_id


def is_cancelled_in_the_queue(service: Service) -> str:
    job_id = service.submit()
    service.cancel(job_id)
    service.run_once()
    return job_id


def is_deleted(service: Service) -> str:
    job_id = _whole_life(service, completes)
    service.delete(job_id)
    service.run_once()
    return job_id


def completes_unharmed(service: Service) -> str:
    return _whole_life(service, completes)


Live = Callable[[Service], str]

# A life, how it ends (None: deleted), whose writes fail; and where it begins or ends as `completes_unharmed`
# does, whose writes there fail already.
LIVES: dict[str, tuple[Live, JobStatus | None, Role, Literal["", "begins", "ends"]]] = {
    "completes, by the worker": (completes_unharmed, JobStatus.SUCCEEDED, "worker", ""),
    "completes, by the reconciler": (completes_unharmed, JobStatus.SUCCEEDED, "reconciler", ""),
    "is cancelled in the queue, by the API": (is_cancelled_in_the_queue, JobStatus.CANCELLED, "api", ""),
    "is cancelled, by the API": (
        partial(_whole_life, end=is_cancelled),
        JobStatus.CANCELLED,
        "api",
        "begins",
    ),
    "is cancelled, by the worker": (
        partial(_whole_life, end=is_cancelled),
        JobStatus.CANCELLED,
        "worker",
        "begins",
    ),
    "is given back, by the worker": (
        partial(_whole_life, end=drains_at_first),
        JobStatus.SUCCEEDED,
        "worker",
        "begins",
    ),
    "is taken back, by the reconciler": (
        partial(_whole_life, end=is_silent_at_first),
        JobStatus.SUCCEEDED,
        "reconciler",
        "ends",
    ),
    "is deleted, by the API": (is_deleted, None, "api", "begins"),
    "is deleted, by the reconciler": (is_deleted, None, "reconciler", "begins"),
}


@pytest.mark.parametrize("name", LIVES)
def test_a_job_comes_to_its_end_whichever_write_fails(
    name: str, job_store: PostgresJobStore, object_store: S3ObjectStore, database: Database
) -> None:
    live, expected, role, known = LIVES[name]
    real = Process(job_store, object_store, MemoryJobQueue())

    def num_writes(live: Live) -> int:
        live(Service(real, database, role, counted := Crash()))
        return counted.num_writes

    first, last = 1, num_writes(live)
    if known == "begins":  # Not with its last write, by which that life ends as this one does not.
        first = max(1, num_writes(completes_unharmed))
    elif known == "ends":
        last -= num_writes(completes_unharmed)
    assert first <= last
    job_ids: list[str] = []
    for failure, at in itertools.product(Failure, range(first, last + 1)):
        crash = Crash(at, failure)
        service = Service(real, database, role, crash)
        job_id = live(service)
        job_ids.append(job_id)
        problems = list(_problems(real, service, job_id, expected))
        assert not problems, f"write {at} of {last} is met by {failure}: {problems}"
        assert crash.has_happened
    assert database.count("dispatches") == 0
    while (dispatch := real.queue.take()) is not None:  # One that Redis was to forget does no harm.
        assert _claim(real, dispatch, new_secret()) is None
    for _ in orphans.sweep(store=job_store, objects=object_store, grace=-timedelta(days=1)):
        pass
    for job_id in job_ids:
        left = {info.key for info in object_store.list(keys.job(job_id))}
        assert left <= _may_stay(real, job_id), f"orphans of {job_id}"


def _problems(real: Process, service: Service, job_id: str, expected: JobStatus | None) -> Iterator[str]:
    listed = real.store.list(JobQuery(name=service.name)).jobs
    if expected is None:
        if listed or list(real.objects.list(keys.job(job_id))):
            yield "something of it is still there"
        return
    if [job.id for job in listed] != [job_id]:
        yield f"one submission made {len(listed)} jobs"
    job = real.store.get(job_id)
    if job.status is not expected or job.token:
        yield f"it is {job.status}: {job.message}"
    yield from _problems_of_feeds(real, job)
    if [artifact.step for artifact in job.artifacts] != ([STEPS[-1]] if job.attempts else []):
        yield f"it has {[artifact.name for artifact in job.artifacts]}"
    for artifact in job.artifacts:
        if hashlib.sha256(real.objects.get(artifact.key)).hexdigest() != artifact.sha256:
            yield f"{artifact.name} has other bytes than its hash says"


def _problems_of_feeds(real: Process, job: Job) -> Iterator[str]:
    events = read_feed(job.id, "events", store=real.store, objects=real.objects)
    logs = read_feed(job.id, "logs", store=real.store, objects=real.objects)
    for feed in (events, logs):
        if [int(entry.id) for entry in feed] != list(range(1, len(feed) + 1)):
            yield f"a feed has a gap or a double: {[entry.id for entry in feed]}"
    ends = [e.data["status"] for e in events if e.kind == "status" and JobStatus(e.data["status"]).is_final]
    if ends != [job.status]:
        yield f"it ended as {ends}"
    lines = [entry.data["text"] for entry in logs]
    steps = {int(line.split()[-1]) for line in lines}
    if len(set(lines)) != len(lines) or steps != (set(STEPS) if job.attempts else set()):
        yield f"its log is {lines}"


def _may_stay(real: Process, job_id: str) -> set[str]:
    """The keys that the record names."""
    return set(real.store.objects_named([job_id]))
