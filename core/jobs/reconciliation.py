"""Repairs what crashes left behind. Idempotent, and safe to run in many places at once."""

from collections.abc import Collection, Iterable, Sequence, Set
from contextlib import suppress
from datetime import timedelta

import structlog

from core.errors import JobNotFound, JobUnreadable, RecordsUnavailable, StaleJob
from core.jobs.attempts import given_back
from core.jobs.job import Job
from core.jobs.queue import JobQueue
from core.jobs.status import JobStatus
from core.jobs.store import Dispatch, JobStore
from core.jobs.submission import hand_over
from core.reasons import Reason

log = structlog.get_logger()


class Reconciler:
    """Checks unfinished work; call `look` every second or two.

    lease: how long a silent worker keeps its job.
    """

    def __init__(self, store: JobStore, queue: JobQueue, lease: timedelta) -> None:
        self._store = store
        self._queue = queue
        self._lease = lease
        self._missing: Set[Dispatch] = frozenset()

    def look(self) -> int:
        """Returns the number of repairs. Raises RecordsUnavailable.

        Hands over dispatches that were committed but not handed over. Takes held jobs whose lease has run
        out back from their workers. Hands over again what waits and the queue has forgotten.
        """
        self._store.beat(self._lease)
        taken = [job for job in self._store.expired() if self._take_back(job)]
        # In this order: the queue already knows a dispatch that another process hands over in between.
        late = self._store.undispatched()
        known = self._queue.known()
        heard = {dispatch for dispatch in late if _is_known(dispatch, known, self._queue)}
        handed = self._hand_over(dispatch for dispatch in late if dispatch not in heard)
        handed += self._hand_over(self._forgotten({*known, *((one.subject, one.attempt) for one in handed)}))
        self._store.dispatched([*heard, *handed])
        return len(taken) + len(handed)

    def _take_back(self, job: Job) -> bool:
        worker = job.attempts[-1].worker
        message = (
            f"Worker {worker} was silent for longer than its lease of {self._lease.total_seconds():g} s."
        )
        try:
            taken = given_back(job, Reason.WORKER_LOST, message, self._store.now())
            self._store.take_back(taken)
        except (StaleJob, JobNotFound):  # The worker has renewed its lease, or another reconciler was faster.
            return False
        log.warning("job_taken_back", job_id=job.id, worker=worker, status=taken.status)
        with suppress(RecordsUnavailable):  # Nobody else would remove its message.
            self._queue.remove(job.id, len(job.attempts))
        if taken.status == JobStatus.QUEUED:
            self._hand_over([Dispatch("attempt", taken.id, taken.next_attempt)])
        return True

    def _forgotten(self, known: Collection[tuple[str, int]]) -> Sequence[Dispatch]:
        """Dispatches that were missing from the queue at two reads: at one, a worker may be taking it."""
        waiting = frozenset(
            dispatch for dispatch in self._store.waiting() if not _is_known(dispatch, known, self._queue)
        )
        forgotten = waiting & self._missing
        self._missing = waiting - forgotten
        return sorted(forgotten, key=lambda dispatch: dispatch.subject)

    def _hand_over(self, dispatches: Iterable[Dispatch]) -> list[Dispatch]:
        """The dispatches that the queue has received; stops at the first failure: others would fail, too."""
        heard: list[Dispatch] = []
        for dispatch in dispatches:
            try:
                if not hand_over(dispatch, store=self._store, queue=self._queue):
                    break
            except (JobNotFound, JobUnreadable):  # Deleted meanwhile, or set aside.
                self._store.dispatched([dispatch])
            else:
                log.info("dispatched", task=dispatch.task, subject=dispatch.subject)
                heard.append(dispatch)
        return heard


def _is_known(dispatch: Dispatch, known: Collection[tuple[str, int]], queue: JobQueue) -> bool:
    if dispatch.task == "model":
        return queue.contains_model(dispatch.subject)
    return (dispatch.subject, dispatch.attempt) in known
