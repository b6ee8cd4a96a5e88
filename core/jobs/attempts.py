"""What an attempt may do to its job: every write carries its token, so that a stale one changes nothing."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from core.errors import IllegalTransition, LeaseLost, StaleJob
from core.jobs.durability import Manifest, keep_record
from core.jobs.job import Artifact, Job
from core.jobs.status import LOSSES, JobStatus, Reason
from core.jobs.store import JobStore
from core.storage import keys
from core.storage.objects import ObjectStore


@dataclass(frozen=True)
class Holding:
    """An attempt that holds its job."""

    job_id: str
    number: int
    token: str
    store: JobStore
    objects: ObjectStore

    def start(self, **facts: Any) -> Job:
        """Running, with what the attempt found out. A job that is being cancelled stays so."""
        return self._change(
            lambda job: job.running(**facts) if job.status == JobStatus.STARTING else job.noted(**facts)
        )

    def publish(self, artifacts: tuple[Artifact, ...], keep_checkpoints: int) -> Job:
        """Let readers see these files, already in the store; forget checkpoints beyond the newest few."""
        dropped: list[Artifact] = []

        def change(job: Job) -> Job:
            grown = job.with_artifacts(artifacts)
            kept = grown.with_newest_checkpoints(keep_checkpoints)
            dropped[:] = [a for a in grown.artifacts if a not in kept.artifacts]
            return kept

        job = self._change(change)
        mine = [a for a in job.artifacts if a.key.startswith(keys.artifact(self.job_id, self.number, ""))]
        manifest = Manifest(job=self.job_id, attempt=self.number, artifacts=mine)
        self.objects.put(
            keys.manifest(self.job_id, self.number),
            manifest.model_dump_json().encode(),
            media_type="application/json",
        )
        for artifact in dropped:
            self.objects.delete_prefix(artifact.key)
        return job

    def end(self, status: JobStatus, reason: Reason, message: str, now: datetime) -> Job:
        """In its final status; the durable record follows."""
        job = self._change(lambda job: job.ended(status, reason, message, now))
        keep_record(job, self.objects)
        return job

    def give_back(self, reason: Reason, message: str, now: datetime) -> Job:
        """Queued for another attempt, unless a cancel has come meanwhile: then cancelled."""
        job = self._change(lambda job: given_back(job, reason, message, now))
        keep_record(job, self.objects)
        return job

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


def claim(  # noqa: PLR0913 # Who, what, and the three places it is written to.
    job_id: str,
    number: int,
    worker: str,
    *,
    store: JobStore,
    objects: ObjectStore,
    lease: timedelta,
    now: datetime,
) -> Holding | None:
    """Take a queued job; None where somebody else has it, or this dispatch is an old one."""
    job = store.get(job_id)
    if job.status != JobStatus.QUEUED or job.next_attempt != number:
        return None
    try:
        claimed = job.claimed(worker, now)
        store.save(claimed, lease=lease)
    except (StaleJob, IllegalTransition):
        return None
    keep_record(claimed, objects)
    return Holding(job_id, number, claimed.token, store, objects)


def given_back(job: Job, reason: Reason, message: str, now: datetime) -> Job:
    """The job after an attempt that did not come to an end: queued, or ended where nothing may follow."""
    if job.status == JobStatus.CANCELLING:
        return job.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, f"Cancelled. {message}", now)
    lost = job.lost_attempts + (reason in LOSSES)
    if lost >= job.spec.max_attempts:
        ending = f"{message} All {job.spec.max_attempts} attempts are used up."
        return job.ended(JobStatus.FAILED, reason, ending, now)
    return job.requeued(reason, message, now)
