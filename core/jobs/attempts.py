"""An attempt's writes to its job: each carries the attempt's token, so that a stale one changes nothing."""

import secrets
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from core.errors import IllegalTransition, LeaseLost, Rejected, StaleJob
from core.jobs.job import Artifact, Job
from core.jobs.pools import GIVEN, Offer
from core.jobs.sharing import alike
from core.jobs.spec import TrainSpec
from core.jobs.status import LOSSES, MAX_ATTEMPTS, RETRIED, JobStatus
from core.jobs.store import JobStore
from core.reasons import Reason
from core.storage.objects import ObjectStore

# Pauses after the first failed attempt, the second, and so on; the last value applies to all later ones.
PAUSES = tuple(timedelta(seconds=seconds) for seconds in (1, 4, 15, 60))
_FAILURES = RETRIED - {Reason.WORKER_LOST}


@dataclass(frozen=True)
class Claim:
    """An attempt that holds its job. Each method may be called again if its answer was lost.

    device: the GPUs that it was given, where its worker belongs to a pool; else empty. gpu_part: of the GPU's
    memory, where it shares the GPU.
    """

    job_id: str
    number: int
    token: str
    store: JobStore
    objects: ObjectStore
    correlation_id: str | None = None
    device: str = ""
    gpu_part: float | None = None

    def start(self, **facts: Any) -> Job:
        """Set the job to running, with facts about the attempt. A job that is being cancelled stays so.

        details: added to those that the claim has stored.
        """

        def change(job: Job) -> Job:
            details = {**job.attempts[-1].details, **facts.get("details", {})}
            said = {**facts, "details": details}
            return job.running(**said) if job.status == JobStatus.STARTING else job.noted(**said)

        return self._change(change)

    def note_peak(self, num_bytes: int) -> Job:
        """Record the most that the attempt has had of a GPU's memory so far."""
        return self._change(lambda job: job.noted(peak_bytes=num_bytes))

    def publish(self, artifacts: tuple[Artifact, ...], keep_checkpoints: int) -> tuple[Job, list[str]]:
        """Record these files, already in the object store; drop all but the newest `keep_checkpoints`.

        Checkpoints that an unfinished job needs stay. Returns the job, and the keys of objects that it no
        longer names: clients may still be reading them.
        """
        dropped: list[str] = []
        promised = [
            step for _, step in self.store.jobs_needing_checkpoint_of(self.job_id) if step is not None
        ]

        def change(job: Job) -> Job:
            changed = job.with_artifacts(artifacts).with_newest_checkpoints(keep_checkpoints, promised)
            named = {artifact.key for artifact in changed.artifacts}
            dropped[:] = [a.key for a in (*job.artifacts, *artifacts) if a.key not in named]
            return changed

        return self._change(change), dropped

    def remove_artifact(self, artifact: Artifact) -> Job:
        """Remove a file from the record, because it is damaged or gone."""
        return self._change(lambda job: job.without_artifacts([artifact]))

    def end(self, status: JobStatus, reason: Reason, message: str) -> Job:
        """End the job with a final status; trainings like it then know what it took of a GPU's memory."""
        now = self.store.now()
        job = self._leave(lambda job: job.ended(status, reason, message, now), message)
        if isinstance(job.spec, TrainSpec):
            with suppress(Rejected):  # A version with other rules accepted it.
                self._learn(job, job.spec)
        return job

    def give_back(self, reason: Reason, message: str) -> Job:
        """Queue the job for another attempt; if a cancel has come meanwhile, cancel it instead."""
        now = self.store.now()
        return self._leave(lambda job: given_back(job, reason, message, now), message)

    def _learn(self, job: Job, spec: TrainSpec) -> None:
        """Only a whole training has had all that it needs. After too small a part, the next is measured."""
        last = job.attempts[-1]
        if job.status == JobStatus.SUCCEEDED and last.peak_bytes is not None:
            self.store.keep_peak(alike(spec), last.peak_bytes)
        is_too_small = last.reason == Reason.OUT_OF_MEMORY and last.gpu_part is not None
        if is_too_small and spec.resources.gpu_memory_gib is None:
            self.store.forget_peak(alike(spec))

    def _leave(self, change: Callable[[Job], Job], message: str) -> Job:
        try:
            job = self._change(change)
        except LeaseLost:
            job = self.store.get(self.job_id)
            if not self._left(job, message):
                raise
        return job

    def _left(self, job: Job, message: str) -> bool:
        """Whether an earlier call, whose answer was lost, has ended this attempt already."""
        mine = next((attempt for attempt in job.attempts if attempt.token == self.token), None)
        if mine is None or mine.ended_at is None:
            return False
        # The reconciler gives that reason too, with a message of its own.
        return mine.reason != Reason.WORKER_LOST or (message != "" and message in (mine.message or ""))

    def _change(self, change: Callable[[Job], Job]) -> Job:
        while True:
            job = self.store.get(self.job_id)
            if job.token != self.token:
                raise LeaseLost(self.job_id)
            changed = change(job)
            try:
                self.store.save(changed)
            except StaleJob:  # A cancel came between; look again.
                continue
            return changed


def new_secret() -> str:
    """A random secret for the token of one claim."""
    return secrets.token_hex(8)


def claim_turn(  # noqa: PLR0913 # Who, what, and where it is written.
    queues: Sequence[str],
    worker: str,
    *,
    store: JobStore,
    objects: ObjectStore,
    lease: timedelta,
    secret: str,
    details: Mapping[str, Any] | None = None,
    fits: Callable[[Job], bool] = lambda job: True,
    told: str = "",
    offer: Offer | None = None,
) -> Claim | None:
    """Claim the job whose turn it is among those of these queues; None if there is none that may start.

    The rest as for `claim_attempt` and `JobStore.take_turn`. Raises NothingFits.
    """
    job = store.take_turn(
        queues,
        worker,
        lease=lease,
        secret=secret,
        details=details,
        fits=fits,
        told=told,
        offer=offer,
    )
    if job is None:
        return None
    attempt = job.attempts[-1]
    given = attempt.details.get(GIVEN, "")
    return Claim(
        job.id,
        attempt.number,
        job.token,
        store,
        objects,
        job.correlation_id,
        given,
        attempt.gpu_part,
    )


def claim_attempt(  # noqa: PLR0913 # Who, what, and where it is written.
    job_id: str,
    number: int,
    worker: str,
    *,
    store: JobStore,
    objects: ObjectStore,
    lease: timedelta,
    secret: str,
    details: Mapping[str, Any] | None = None,
) -> Claim | None:
    """Claim this attempt, whosever turn it is; None where another one has it, or this dispatch is old.

    secret: a fresh one for each claim. If the answer was lost, a call with the same secret returns the same
    claim again. details: facts about the attempt that are known before it starts.
    """
    job = store.get(job_id)
    claimed = None
    if job.status == JobStatus.QUEUED and job.next_attempt == number:
        claimed = _claimed(job.claimed(worker, store.now(), secret, details or {}), store, lease)
    elif job.token == Job.token_of(number, secret):
        claimed = job
    return None if claimed is None else Claim(job_id, number, claimed.token, store, objects)


def _claimed(claimed: Job, store: JobStore, lease: timedelta) -> Job | None:
    try:
        store.save(claimed, lease=lease)
    except (StaleJob, IllegalTransition):
        return None
    return claimed


def given_back(job: Job, reason: Reason, message: str, now: datetime) -> Job:
    """The job after an attempt that did not finish: queued, or ended if no other attempt may follow."""
    if job.status == JobStatus.CANCELLING:
        return job.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, f"Cancelled. {message}", now)
    lost = job.lost_attempts + (reason in LOSSES)
    if lost >= job.spec.max_attempts:
        ending = f"{message} All {job.spec.max_attempts} attempts are used up."
        return job.ended(JobStatus.FAILED, reason, ending, now)
    if reason in MAX_ATTEMPTS and job.num_ended({reason}) + 1 >= MAX_ATTEMPTS[reason]:
        ending = f"{message} {MAX_ATTEMPTS[reason]} attempts ended like this; there is no further one."
        return job.ended(JobStatus.FAILED, reason, ending, now)
    return job.requeued(reason, message, now, not_before=_not_before(job, reason, now))


def _not_before(job: Job, reason: Reason, now: datetime) -> datetime | None:
    """The pause grows with each failed attempt; after a lost or drained worker there is none."""
    if reason not in _FAILURES:
        return None
    return now + PAUSES[min(job.num_ended(_FAILURES), len(PAUSES) - 1)]
