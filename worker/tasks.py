"""The functions that RQ calls, each in a work-horse of its own. Redis may ask for no other work."""

import os
import signal
import socket
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, ClassVar

import structlog
from rq.job import Job as RqJob

from core.adapters.rq.queue import put_back, this_worker
from core.adapters.wiring import job_store, object_store
from core.configuration import read
from core.errors import JobUnreadable, Misconfigured, NotFound, Unavailable
from core.jobs.attempts import Claim, claim_turn, new_secret
from core.jobs.job import Job
from core.jobs.pools import NothingFits
from core.jobs.queue import queue_names
from core.jobs.status import JobStatus
from core.jobs.store import JobQuery, JobStore
from core.jobs.tallies import Tallies
from core.jobs.workers import WorkerInfo, packages_here, why_left_to_others
from core.previews.record import PreviewRequest
from core.retry import CalledOff, pause, retry_while_unavailable
from core.settings import WorkerSettings
from core.telemetry import configure_logging
from worker.gang.members import gang_here
from worker.host import device_health
from worker.host.allocation import allocation
from worker.host.device import device_of
from worker.host.disk import has_room, what_to_do
from worker.host.locks import slot_names
from worker.host.pool import Kept, Pool, pool_of
from worker.host.processes import die_with_parent
from worker.preview.drawing import draw
from worker.stopping import Draining
from worker.supervision.spool import SPOOLS, remove_left_over, spool
from worker.supervision.supervisor import Supervisor
from worker.validation import clips
from worker.validation.confined import validate

log = structlog.get_logger()

# How long a worker that cannot start a job leaves the queue to others.
_PAUSE_S = 5.0


def run_attempt(job_id: str, attempt: int) -> None:
    """Claim the job whose turn it is, and see its attempt to its end.

    RQ's message says that there is work for slots like this one, and names a job that waited when it was
    sent: another one may have its turn, or none.
    """
    draining = Draining()
    for number in (signal.SIGTERM, signal.SIGUSR1):
        signal.signal(number, draining.set)
    # The work-horse of a killed worker ends, too, but drains first: SIGTERM, not SIGKILL.
    die_with_parent(signal_number=signal.SIGTERM)
    configure_logging("worker", job_id=job_id, attempt=attempt)
    settings = read(WorkerSettings)
    remove_left_over(settings.data_dir / SPOOLS)  # They may be what fills the disk.
    if not has_room(settings.data_dir):
        _leave_to_others(what_to_do(settings.data_dir), draining)
        return
    try:
        device = device_of(settings.device)
        slot_names(device, os.getppid())
        pool = pool_of(settings, device)
    except Misconfigured as error:  # A GPU has gone since the worker started.
        _leave_to_others(error.detail, draining)
        return
    tallies = Tallies()
    store = job_store(settings, observe=tallies.observe_store)
    worker = this_worker() or f"{socket.gethostname()}:{device}"
    gang = gang_here()
    take = partial(
        claim_turn,
        queue_names(device, 1 if gang is None else gang.place.hosts, 1 if pool is None else pool.most_gpus),
        worker,
        store=store,
        objects=object_store(settings, observe=tallies.observe_store),
        lease=settings.lease,
        secret=new_secret(),
        details={"allocation": where} if (where := allocation(os.environ)) else {},
        told=job_id,
    )
    if gang is not None and not gang.answers():
        _leave_to_others(gang.problem or "A host does not answer.", draining)
        return
    held = None
    try:
        workers = retry_while_unavailable(store.workers, called_off=draining.is_set)
        take = partial(take, fits=partial(_fits, has=packages_here(), workers=workers))
        if pool is None:
            claim = retry_while_unavailable(take, called_off=draining.is_set)
        else:
            claim, held = _from_pool(pool, workers, take, draining)
    except (CalledOff, NotFound, JobUnreadable) as error:
        log.info("dispatch_ignored", error=str(error))
        return
    if claim is None:
        log.info("dispatch_ignored")
        return
    configure_logging(
        "worker", job_id=claim.job_id, attempt=claim.number, correlation_id=claim.correlation_id
    )
    device = claim.device or device
    log.info("attempt_began", worker=worker, device=device)
    supervisor = Supervisor(
        claim,
        settings,
        device,
        slot_names(device, os.getppid()),
        draining=draining,
        device_test=device_health.command_for(device),
        gang=gang,
        held=held,
        pool=pool,
        tallies=tallies,
    )
    supervisor.run()


def _from_pool(
    pool: Pool, workers: Sequence[WorkerInfo], take: Callable[..., Claim | None], draining: Draining
) -> tuple[Claim | None, Kept | None]:
    """The job whose turn it is on the GPUs that are free, with their locks. Raises CalledOff.

    Where it cannot have one now, the message goes back into the queue, for another worker or a later moment.
    """
    with pool.turn(draining.is_set) as turn:
        offer = turn.offer(workers)
        if offer is None:
            put_back()
            return None, None
        try:
            claim = retry_while_unavailable(partial(take, offer=offer), called_off=draining.is_set)
        except NothingFits as error:
            log.info("gpus_kept", detail=str(error))
            pool.note_kept(str(error))
            put_back()
            return None, None
        return claim, None if claim is None else turn.keep(claim.device, claim.job_id, claim.gpu_part)


def validate_model(model_id: str) -> None:
    """Examine a model that somebody has sent; skip one that was deleted meanwhile."""
    die_with_parent(signal_number=signal.SIGTERM)
    settings = read(WorkerSettings)
    spools = settings.data_dir.absolute() / SPOOLS
    store = job_store(settings)
    with spool(spools / f"{model_id.replace(':', '-')}.{os.getpid()}") as folder, suppress(NotFound):
        validate(
            model_id,
            store.models,
            object_store(settings),
            folder,
            settings.data_dir.absolute(),
            strictly=settings.models == "confined",
            is_wanted=partial(_a_job_waits, store),
        )


def validate_clips(file_id: str) -> None:
    """Examine a file of clips that somebody has sent; skip one that was deleted meanwhile."""
    die_with_parent(signal_number=signal.SIGTERM)
    settings = read(WorkerSettings)
    data = settings.data_dir.absolute()
    with spool(data / SPOOLS / f"{file_id.replace(':', '-')}.{os.getpid()}") as folder, suppress(NotFound):
        clips.validate_clips(
            file_id,
            job_store(settings),
            object_store(settings),
            folder,
            data,
            strictly=settings.models == "confined",
        )


def _a_job_waits(store: JobStore) -> bool:
    with suppress(Unavailable):
        return bool(store.list(JobQuery(status=JobStatus.QUEUED), limit=1).jobs)
    return False


def draw_preview(document: str) -> None:
    """Draw the stills that a request asks for; none if the model was deleted meanwhile."""
    die_with_parent(signal_number=signal.SIGTERM)
    request = PreviewRequest.model_validate_json(document)
    settings = read(WorkerSettings)
    data = settings.data_dir.absolute()
    with spool(data / SPOOLS / f"preview-{request.id}.{os.getpid()}") as folder, suppress(NotFound):
        draw(request, object_store(settings), folder, data, models=settings.models)


def _fits(job: Job, *, has: Collection[str], workers: Sequence[WorkerInfo]) -> bool:
    """Whether it is for this worker; the reconciler sends a message for what is left to another one."""
    reason = why_left_to_others(job, has, workers)
    if reason is not None:
        log.info("left_to_others", left=job.id, detail=reason)
    return reason is None


def _leave_to_others(reason: str, draining: Draining) -> None:
    """Claim nothing: the reconciler dispatches the job again, to the first worker that is free."""
    log.error("no_job_begun", detail=reason)
    with suppress(CalledOff):
        pause(_PAUSE_S, draining.is_set)


class UnknownTask(Exception):
    """The queue holds a task that this service does not have."""


class NamedJob(RqJob):
    """An RQ job that is one of our tasks. RQ itself would call whatever Python function it names.

    Callbacks are never run: their names come from Redis, too.
    """

    tasks: ClassVar[dict[str, Callable[..., None]]] = {
        f"{task.__module__}.{task.__name__}": task
        for task in (run_attempt, validate_model, validate_clips, draw_preview)
    }

    @property
    def success_callback(self) -> None:
        """None, whatever Redis says."""
        return None

    @property
    def failure_callback(self) -> None:
        """None, whatever Redis says."""
        return None

    @property
    def stopped_callback(self) -> None:
        """None, whatever Redis says."""
        return None

    @property
    def func(self) -> Callable[..., Any]:
        """The task. Raises UnknownTask."""
        task = self.tasks.get(str(self.func_name))
        if task is None or self.instance is not None:
            raise UnknownTask(f"{str(self.func_name)[:80]!r} is no task of a Gaitway worker.")
        return task
