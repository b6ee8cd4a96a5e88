"""The parts of a worker, played by a test."""

import hashlib
import secrets
from datetime import timedelta
from typing import Any

from core.jobs.attempts import Claim, claim_attempt, new_secret
from core.jobs.job import Artifact, Job
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.store import Channel, Entry, JobStore
from core.jobs.submission import Acknowledgements, submit
from core.reasons import Reason
from core.storage import keys
from core.storage.objects import ObjectStore
from tests.in_memory import MemoryJobQueue

LEASE = timedelta(minutes=1)


class PlayedWorker:
    """Submits jobs, and does with them what a worker does."""

    def __init__(self, store: JobStore, objects: ObjectStore) -> None:
        self.store, self.objects = store, objects
        self._queue = MemoryJobQueue()

    def submit(self, **fields: Any) -> Job:
        spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", **fields})
        heard = Acknowledgements(self.store.dispatched)
        return submit(spec, store=self.store, queue=self._queue, acknowledge=heard.add_at_once)

    def begin(self, job: Job) -> Claim:
        """Running on a CPU."""
        claim = claim_attempt(
            job.id,
            self.store.get(job.id).next_attempt,
            "worker-1",
            store=self.store,
            objects=self.objects,
            lease=LEASE,
            secret=new_secret(),
        )
        assert claim is not None
        claim.start(device="cpu", engine="native")
        return claim

    def run(self, steps: int = 1, **fields: Any) -> Job:
        """A job that has succeeded, with so many checkpoints."""
        claim = self.begin(self.submit(**fields))
        for step in range(1, steps + 1):
            self.checkpoint(claim, step)
        return self.succeed(claim)

    def checkpoint(self, claim: Claim, step: int, keep: int = 5) -> Artifact:
        """Published, with a body of its own."""
        name = f"checkpoint-{step:012d}.msgpack"
        artifact = self.upload(claim, name, f"{claim.job_id} {step}".encode(), step)
        claim.publish((artifact,), keep)
        return artifact

    def upload(self, claim: Claim, name: str, body: bytes, step: int | None = None) -> Artifact:
        """In the object store, and not in the record yet."""
        digest = hashlib.sha256(body).hexdigest()
        key = keys.artifact(claim.job_id, claim.number, digest, name)
        self.objects.put(key, body)
        return Artifact(
            name=name, role="checkpoint", media_type="", size=len(body), sha256=digest, key=key, step=step
        )

    def say(self, claim: Claim, channel: Channel, *texts: str) -> None:
        entries = [
            Entry(kind="line" if channel == "logs" else "note", time=self.store.now(), data={"text": text})
            for text in texts
        ]
        self.store.record(claim.job_id, claim.token, channel, entries, write_id=secrets.token_hex(8))

    def succeed(self, claim: Claim) -> Job:
        return claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "It came to its end.")
