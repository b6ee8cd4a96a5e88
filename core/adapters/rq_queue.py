"""The job queue on RQ."""

import time
from datetime import timedelta
from typing import Any

from redis import Redis
from rq import Queue
from rq.exceptions import DuplicateJobError, NoSuchJobError
from rq.job import Job as RQJob
from rq.job import JobStatus as RQStatus
from rq.serializers import JSONSerializer

from core.adapters.redis_errors import reaching_redis
from core.jobs.queue import queue_name
from core.jobs.spec import Accelerator, Priority

TASK = "worker.tasks.run_attempt"
_KEEP_FAILURES = timedelta(days=1)
_NO_LIMIT = -1  # the supervisor keeps the deadline


class RQQueue:
    """A JobQueue whose workers are RQ's; they call `TASK` with the job's id and the attempt."""

    def __init__(self, client: "Redis") -> None:
        self._redis: Any = client

    @reaching_redis()
    def enqueue(
        self, job_id: str, attempt: int, *, accelerator: Accelerator, priority: Priority, gpus: int = 1
    ) -> None:
        name = queue_name(accelerator, priority, gpus)
        queue = Queue(name, connection=self._redis, serializer=JSONSerializer)
        try:
            self._push(queue, job_id, attempt)
        except DuplicateJobError:
            # RQ may know an attempt that it has lost: its worker died between taking it and starting it.
            if not self.contains(job_id, attempt):
                self.remove(job_id, attempt)
                self._push(queue, job_id, attempt)

    @reaching_redis()
    def contains(self, job_id: str, attempt: int) -> bool:
        found = self._find(job_id, attempt)
        if found is None:
            return False
        if found.get_status(refresh=False) == RQStatus.QUEUED:
            return (
                self._redis.lpos(Queue.redis_queue_namespace_prefix + str(found.origin), found.id) is not None
            )
        # Started: as long as the worker that took it prolongs its entry.
        return self._redis.zcount(found.execution_registry.key, time.time(), "+inf") > 0

    @reaching_redis()
    def remove(self, job_id: str, attempt: int) -> None:
        found = self._find(job_id, attempt)
        if found is not None:
            found.delete()

    def _push(self, queue: Queue, job_id: str, attempt: int) -> None:
        queue.enqueue_call(  # pyright: ignore[reportUnknownMemberType]
            TASK,
            args=(job_id, attempt),
            job_id=_rq_id(job_id, attempt),
            unique=True,
            timeout=_NO_LIMIT,
            result_ttl=0,
            failure_ttl=int(_KEEP_FAILURES.total_seconds()),
        )

    def _find(self, job_id: str, attempt: int) -> RQJob | None:
        try:
            return RQJob.fetch(  # pyright: ignore[reportUnknownMemberType]
                _rq_id(job_id, attempt), connection=self._redis, serializer=JSONSerializer
            )
        except NoSuchJobError:
            return None


def job_of(rq_id: str) -> str:
    """The job that RQ's name for an attempt belongs to."""
    return rq_id.rpartition("_")[0]


def _rq_id(job_id: str, attempt: int) -> str:
    return f"{job_id}_{attempt}"
