"""Repairs what crashes left behind. Idempotent, and safe to run in many places at once."""

import time
from collections.abc import Collection, Mapping, Sequence, Set
from contextlib import suppress
from datetime import timedelta

import structlog

from core.errors import JobNotFound, RecordsUnavailable, StaleJob
from core.jobs.attempts import given_back
from core.jobs.job import Job
from core.jobs.queue import MOST_WAITING, JobQueue, all_queues
from core.jobs.store import Dispatch, JobStore
from core.jobs.submission import hand_over
from core.reasons import Reason

log = structlog.get_logger()

# How much one look hands over, and for how long at most: meanwhile no lease is watched. After Redis was
# emptied, the next looks hand over the rest.
_AT_ONCE, _FOR_S = 500, 1.0
# Within this time a worker that has taken a message has claimed a job by it.
_CLAIMED_WITHIN_S = 10.0
# Jobs that this version cannot read are left out of later looks, so that others get their turn.
_MOST_SET_ASIDE = 10_000


class Reconciler:
    """Checks unfinished work; call `run_once` every second or two.

    lease: how long a silent worker keeps its job.
    """

    def __init__(self, store: JobStore, queue: JobQueue, lease: timedelta) -> None:
        self._store = store
        self._queue = queue
        self._lease = lease
        # Since when what waits in the record has not waited in the queue, at each look.
        self._missing: Mapping[Dispatch, float] = {}
        self._unreadable: set[tuple[str, int]] = set()

    def run_once(self) -> int:
        """Returns the number of repairs. Raises RecordsUnavailable.

        Takes held jobs whose lease has run out back from their workers. Hands over what waits and the queue
        does not have, as far as it has room: a dispatch that was committed and not handed over, and one that
        the queue has forgotten. Tells running jobs to make room for others.
        """
        self._store.beat(self._lease)
        taken = [job for job in self._store.expired() if self._take_back(job)]
        # In this order: the queue already knows a dispatch that another process hands over in between.
        late = frozenset(self._store.undispatched())
        known, busy = self._queue.known(), frozenset(self._queue.taken())
        heard = {dispatch for dispatch in late if _is_known(dispatch, known, self._queue)}
        handed = self._hand_over(self._lacking(late, known, busy), busy)
        self._missing = {one: since for one, since in self._missing.items() if one not in frozenset(handed)}
        self._store.dispatched([*heard, *handed])
        for waiting, victims in self._store.make_room().items():
            log.info("jobs_make_room", waiting=waiting, drained=list(victims))
        return len({*(job.id for job in taken), *(dispatch.subject for dispatch in handed)})

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
        log.warning(
            "job_taken_back",
            job_id=job.id,
            worker=worker,
            status=taken.status,
            correlation_id=job.correlation_id,
        )
        with suppress(RecordsUnavailable):  # Nobody else would remove its message.
            self._queue.remove(job.id, len(job.attempts))
        return True

    def _lacking(
        self, late: Set[Dispatch], known: Collection[tuple[str, int]], busy: Set[tuple[str, int]]
    ) -> Sequence[Dispatch]:
        """The dispatches that the queue gets now, the most urgent first.

        One that was handed over before must be missing at two looks: at one, a worker may be taking it. One
        whose message a worker has (`busy`) must be found waiting for longer: then it has another job by it.
        """
        waits = {one for one in known if one not in busy}
        waiting = self._queue.num_waiting(all_queues(self._store.queues_of_several_hosts()))
        room = {name: MOST_WAITING - number for name, number in waiting.items() if number < MOST_WAITING}
        found = [
            dispatch
            for dispatch in self._store.waiting(room, {*waits, *self._unreadable})
            if not _is_known(dispatch, waits, self._queue)
        ]
        before, now = self._missing, time.monotonic()
        self._missing = {dispatch: before.get(dispatch, now) for dispatch in found}

        def is_due(dispatch: Dispatch) -> bool:
            if (dispatch.subject, dispatch.attempt) in busy:
                return now - self._missing[dispatch] >= _CLAIMED_WITHIN_S
            return dispatch in late or dispatch in before

        return [dispatch for dispatch in found if is_due(dispatch)][:_AT_ONCE]

    def _hand_over(self, dispatches: Sequence[Dispatch], busy: Set[tuple[str, int]]) -> list[Dispatch]:
        """The dispatches that the queue has received; stops at the first failure: others would fail, too."""
        jobs = self._store.jobs_of([one.subject for one in dispatches if one.task == "attempt"])
        heard: list[Dispatch] = []
        until = time.monotonic() + _FOR_S
        for dispatch in dispatches:
            job = jobs.get(dispatch.subject)
            if dispatch.task == "attempt" and not isinstance(job, Job):  # Deleted meanwhile, or set aside.
                self._set_aside(dispatch)
                continue
            again = (dispatch.subject, dispatch.attempt) in busy
            if time.monotonic() > until or not hand_over(
                dispatch, queue=self._queue, job=job if isinstance(job, Job) else None, again=again
            ):
                break
            of_request = {"correlation_id": job.correlation_id} if isinstance(job, Job) else {}
            log.info("dispatched", task=dispatch.task, subject=dispatch.subject, **of_request)
            heard.append(dispatch)
        return heard

    def _set_aside(self, dispatch: Dispatch) -> None:
        if len(self._unreadable) >= _MOST_SET_ASIDE:
            self._unreadable.clear()
        self._unreadable.add((dispatch.subject, dispatch.attempt))
        self._store.dispatched([dispatch])


def _is_known(dispatch: Dispatch, known: Collection[tuple[str, int]], queue: JobQueue) -> bool:
    if dispatch.task == "attempt":
        return (dispatch.subject, dispatch.attempt) in known
    return queue.contains_upload(dispatch.task, dispatch.subject)


class StrayMessages:
    """Drops what was a stray at two reads of the queue: during one, a worker may just be taking it."""

    def __init__(self, queue: JobQueue) -> None:
        self._queue = queue
        self._seen: Set[str] = frozenset()

    def run_once(self) -> int:
        """Returns how many were dropped. Raises RecordsUnavailable."""
        found = self._queue.strays()
        dropped = found & self._seen
        if dropped:
            self._queue.drop(dropped)
        self._seen = found - dropped
        return len(dropped)
