"""The job queue on RQ."""

import secrets
import time
from collections.abc import Callable, Collection, Mapping, Set
from contextlib import suppress
from datetime import timedelta
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

from redis import Redis
from redis.exceptions import RedisError
from rq import Queue, get_current_job
from rq.exceptions import DuplicateJobError, InvalidJobOperation, NoSuchGroupError
from rq.job import Job as RQJob
from rq.job import JobStatus as RQStatus
from rq.serializers import JSONSerializer

from core.adapters.redis.errors import reaching_redis
from core.adapters.timing import Observe, timed, unobserved
from core.errors import Unavailable
from core.jobs.queue import MODELS, PREVIEWS
from core.previews.record import PreviewRequest
from core.uploads.record import KindName

TASK = "worker.tasks.run_attempt"
UPLOAD_TASKS: Mapping[KindName, str] = {
    "model": "worker.tasks.validate_model",
    "clips": "worker.tasks.validate_clips",
}
PREVIEW_TASK = "worker.tasks.draw_preview"
# Nobody needs RQ's view of a failure: the record says why an attempt ended.
_KEEP_FAILURES = timedelta(minutes=1)
_NO_LIMIT = -1  # the supervisor keeps the deadline
# RQ's prefixes of keys, and the time to live that Redis reports for a key without one.
_MESSAGE, _EXECUTIONS, _FOR_EVER = "rq:job:", "rq:executions:", -1


Arguments = ParamSpec("Arguments")
Answer = TypeVar("Answer")


def _reaching(
    method: Callable[Concatenate["RQQueue", Arguments], Answer],
) -> Callable[Concatenate["RQQueue", Arguments], Answer]:
    """Times a method, and turns Redis' errors into the service's own."""

    @wraps(method)
    def reach(queue: "RQQueue", *args: Arguments.args, **kwargs: Arguments.kwargs) -> Answer:
        with timed(queue.observe, "redis"), reaching_redis():
            return method(queue, *args, **kwargs)

    return reach


class RQQueue:
    """A JobQueue whose workers are RQ's.

    They call `TASK` with a job's id and the attempt, one of `UPLOAD_TASKS` with a file's
    id, and `PREVIEW_TASK` with a request as JSON.
    """

    def __init__(self, client: "Redis", observe: Observe = unobserved) -> None:
        self._redis: Any = client
        self.observe = observe

    @_reaching
    def enqueue(self, job_id: str, attempt: int, *, name: str, again: bool = False) -> None:
        rq_id = _rq_id(job_id, attempt)
        if again and (job_id, attempt) in _attempts(self._messages()[1]):
            # RQ has each id once, as long as its worker is busy.
            rq_id = f"{rq_id}_{secrets.token_hex(4)}"
        self._enqueue(name, rq_id, TASK, (job_id, attempt))

    @_reaching
    def num_waiting(self, names: Collection[str]) -> Mapping[str, int]:
        with self._redis.pipeline(transaction=False) as pipeline:
            for name in names:
                pipeline.llen(Queue.redis_queue_namespace_prefix + name)
            return dict(zip(names, pipeline.execute(), strict=True))

    @_reaching
    def contains(self, job_id: str, attempt: int) -> bool:
        return self._contains(_rq_id(job_id, attempt))

    @_reaching
    def known(self) -> Collection[tuple[str, int]]:
        return _attempts(self._held())

    @_reaching
    def taken(self) -> Collection[tuple[str, int]]:
        waiting, started = self._messages()
        return _attempts(started) - _attempts(waiting)

    @_reaching
    def strays(self) -> Set[str]:
        # Messages that RQ keeps for a while have a time to live.
        found = [key.decode() for key in self._redis.scan_iter(f"{_MESSAGE}*", count=1000)]
        names = {key.removeprefix(_MESSAGE) for key in found} - self._held()
        with self._redis.pipeline(transaction=False) as pipeline:
            for name in names:
                pipeline.ttl(_MESSAGE + name)
            lives: list[int] = pipeline.execute()
        return {name for name, life in zip(names, lives, strict=True) if life == _FOR_EVER}

    @_reaching
    def drop(self, names: Collection[str]) -> None:
        self._redis.delete(*(prefix + name for name in names for prefix in (_MESSAGE, _EXECUTIONS)))

    @_reaching
    def remove(self, job_id: str, attempt: int) -> None:
        self._remove(_rq_id(job_id, attempt))

    @_reaching
    def enqueue_upload(self, kind: KindName, upload_id: str) -> None:
        self._enqueue(MODELS, _upload_rq_id(upload_id), UPLOAD_TASKS[kind], (upload_id,))

    @_reaching
    def contains_upload(self, kind: KindName, upload_id: str) -> bool:
        return self._contains(_upload_rq_id(upload_id))

    @_reaching
    def enqueue_preview(self, request: PreviewRequest) -> None:
        self._enqueue(PREVIEWS, _preview_rq_id(request.id), PREVIEW_TASK, (request.model_dump_json(),))

    @_reaching
    def contains_preview(self, preview_id: str) -> bool:
        return self._contains(_preview_rq_id(preview_id))

    @_reaching
    def num_previews(self) -> int:
        waiting = Queue(PREVIEWS, connection=self._redis, serializer=JSONSerializer).job_ids
        return sum(rq_id.startswith(_preview_rq_id("")) for rq_id in waiting)

    def _held(self) -> Set[str]:
        waiting, started = self._messages()
        return waiting | started

    def _messages(self) -> tuple[Set[str], Set[str]]:
        """RQ's ids of messages that wait, and of those that a worker has started and prolongs."""
        queues = Queue.all(connection=self._redis, serializer=JSONSerializer)  # pyright: ignore[reportUnknownMemberType]
        with self._redis.pipeline(transaction=False) as pipeline:
            for queue in queues:
                pipeline.lrange(queue.key, 0, -1)
                pipeline.zrangebyscore(queue.started_job_registry.key, time.time(), "+inf")
            found: list[list[bytes]] = pipeline.execute()
        waiting, started = (
            # A started message is listed with the id of its execution after a colon.
            {name.decode(errors="replace").partition(":")[0] for names in found[at::2] for name in names}
            for at in (0, 1)
        )
        return waiting, started

    def _enqueue(self, name: str, rq_id: str, task: str, args: tuple[Any, ...]) -> None:
        queue = Queue(name, connection=self._redis, serializer=JSONSerializer)
        try:
            _push(queue, rq_id, task, args)
        except DuplicateJobError:
            # RQ may still know a message that is lost: its worker died between taking and starting it.
            if not self._contains(rq_id):
                self._remove(rq_id)
                with suppress(DuplicateJobError):  # The API or the reconciler was faster.
                    _push(queue, rq_id, task, args)

    def _contains(self, rq_id: str) -> bool:
        found = self._find(rq_id)
        if found is None:
            return False
        if found.get_status(refresh=False) == RQStatus.QUEUED:
            return (
                self._redis.lpos(Queue.redis_queue_namespace_prefix + str(found.origin), found.id) is not None
            )
        # It is started; it counts as long as its worker prolongs its entry.
        return self._redis.zcount(found.execution_registry.key, time.time(), "+inf") > 0

    def _remove(self, rq_id: str) -> None:
        found = self._find(rq_id)
        if found is not None:
            # Its worker may be ending it: RQ then finds only half of it, or of an execution.
            with suppress(InvalidJobOperation, NoSuchGroupError, KeyError, ValueError):
                found.delete()
        self.drop([rq_id])

    def _find(self, rq_id: str) -> RQJob | None:
        """RQ's message; None if there is none, or a damaged one, which `_remove` deletes."""
        try:
            return RQJob.fetch(  # pyright: ignore[reportUnknownMemberType]
                rq_id, connection=self._redis, serializer=JSONSerializer
            )
        except RedisError:
            raise
        except Exception:  # RQ does not check what it reads: its parsers raise many kinds of errors.
            return None


def _push(queue: Queue, rq_id: str, task: str, args: tuple[Any, ...]) -> None:
    queue.enqueue_call(  # pyright: ignore[reportUnknownMemberType]
        task,
        args=args,
        job_id=rq_id,
        unique=True,
        timeout=_NO_LIMIT,
        result_ttl=0,
        failure_ttl=int(_KEEP_FAILURES.total_seconds()),
    )


def this_worker() -> str | None:
    """The name of the worker whose work-horse this process is; None if it is no work-horse."""
    job = get_current_job()
    return None if job is None else job.worker_name


def put_back() -> None:
    """Send the message of this work-horse once more: its worker has claimed nothing by it.

    If Redis is away, the reconciler sends it.
    """
    job = get_current_job()
    if job is not None and (job_id := job_of(job.id)):
        attempt = int(job.id.split("_")[1])
        with suppress(Unavailable):
            RQQueue(job.connection).enqueue(job_id, attempt, name=str(job.origin), again=True)


def job_of(rq_id: str) -> str | None:
    """The id of the job whose attempt has this id in RQ; None if it is not an attempt's."""
    job_id, of_attempt, _ = rq_id.partition("_")
    return job_id if of_attempt else None


def _rq_id(job_id: str, attempt: int) -> str:
    return f"{job_id}_{attempt}"


def _attempts(rq_ids: Set[str]) -> Set[tuple[str, int]]:
    """The jobs and attempts of these messages; a third part tells messages of one attempt apart."""
    parts = (rq_id.split("_") for rq_id in rq_ids)
    return {(part[0], int(part[1])) for part in parts if len(part) in (2, 3) and part[1].isdecimal()}


def _upload_rq_id(upload_id: str) -> str:
    """No two kinds have an id in common."""
    return upload_id.replace(":", "-")


def _preview_rq_id(preview_id: str) -> str:
    return f"preview-{preview_id}"
