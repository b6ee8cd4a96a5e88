"""What tests of the supervisor share: a service in one process, and a training of the smallest size."""

import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

from pydantic import SecretStr

from core.jobs.attempts import Claim, claim_attempt, new_secret
from core.jobs.ending import cancel
from core.jobs.job import Job
from core.jobs.spec import JOB_SPEC
from core.jobs.store import Channel, Entry, JobStore
from core.jobs.submission import submit
from core.settings import WorkerSettings
from tests.feeds import read_feed
from tests.in_memory import MemoryJobQueue, MemoryObjectStore
from worker.supervision.supervisor import Supervisor

PROBE = Path(__file__).with_name("probe_process.py")

# A real training process; ten million steps last longer than any test.
SPEC: dict[str, Any] = {
    "kind": "train",
    "environment": "inverted_pendulum",
    "algorithm": {
        "num_timesteps": 10_000_000,
        "num_envs": 64,
        "unroll_length": 10,
        "batch_size": 16,
        "num_minibatches": 4,
        "num_evals": 0,
        "episode_length": 100,
        "policy_hidden_layer_sizes": [16],
        "value_hidden_layer_sizes": [16],
    },
    "checkpoints": {"every_steps": 64_000},
}


def unused_servers(data_dir: Path) -> WorkerSettings:
    """Settings of a quick worker, whose addresses nobody looks at."""
    return WorkerSettings(
        database_url=SecretStr("postgresql://unused"),
        redis_url=SecretStr("unix:///unused"),
        s3_endpoint="unused",
        s3_access_key="unused",
        s3_secret_key=SecretStr("unused"),
        data_dir=data_dir,
        heartbeat=timedelta(seconds=0.02),
        # Longer than a process takes to go, also on a busy machine.
        grace=timedelta(seconds=15),
    )


class Bench:
    """A service with its queue and objects in memory, and supervisors for the probe process."""

    def __init__(self, data_dir: Path, store: JobStore) -> None:
        self.store, self.queue, self.objects = store, MemoryJobQueue(), MemoryObjectStore()
        self.settings = unused_servers(data_dir)

    def submit(self, **fields: Any) -> Job:
        spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", **fields})
        return submit(spec, store=self.store, queue=self.queue)

    def claim(self, job: Job) -> Claim:
        claim = claim_attempt(
            job.id,
            self.store.get(job.id).next_attempt,
            "w",
            store=self.store,
            objects=self.objects,
            lease=self.settings.lease,
            secret=new_secret(),
        )
        assert claim is not None
        return claim

    def supervisor(self, job: Job, behaviour: str) -> Supervisor:
        claim = self.claim(job)
        return Supervisor(claim, self.settings, "cpu", ("slot",), (sys.executable, str(PROBE), behaviour))

    def run(self, behaviour: str, **fields: Any) -> Job:
        job = self.submit(**fields)
        self.supervisor(job, behaviour).run()
        return self.store.get(job.id)

    def cancel(self, job: Job) -> None:
        cancel(job.id, store=self.store, queue=self.queue)

    def feed(self, job: Job, channel: Channel, kind: str | None = None) -> Sequence[Entry]:
        """All of it."""
        return read_feed(job.id, channel, store=self.store, objects=self.objects, kind=kind)

    def lines(self, job: Job) -> list[str]:
        """Its log."""
        return [entry.data["text"] for entry in self.feed(job, "logs")]

    def printed(self, job: Job) -> list[str]:
        """The part of its log that the process printed: the supervisor's own lines begin with their time."""
        return [line for line in self.lines(job) if re.match(r"\d\d:\d\d:\d\d  | {10}", line) is None]

    @contextmanager
    def running(self, job: Job, behaviour: str) -> Iterator[Supervisor]:
        """Its supervisor in a thread; inside the block, the first checkpoint is there."""
        supervisor = self.supervisor(job, behaviour)
        thread = threading.Thread(target=supervisor.run)
        thread.start()
        wait_until(lambda: self.store.get(job.id).newest("checkpoint") is not None)
        yield supervisor
        thread.join(20)
        assert not thread.is_alive()


def wait_until(condition: Callable[[], bool], timeout_s: float = 30) -> None:
    """Most conditions read the record: asked more often, they would take the time of what is waited for."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.05)
