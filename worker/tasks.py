"""The functions that RQ calls, each in a work-horse of its own."""

import os
import signal
import socket
from contextlib import suppress
from functools import partial

import structlog

from core.adapters.rq.queue import this_worker
from core.adapters.wiring import job_store, object_store
from core.configuration import read
from core.errors import JobUnreadable, Misconfigured, NotFound, Unavailable
from core.jobs.attempts import claim_attempt, new_secret
from core.jobs.job import Job
from core.jobs.status import JobStatus
from core.jobs.store import JobQuery, JobStore
from core.jobs.workers import packages_here, why_left_to_others
from core.previews.record import PreviewRequest
from core.retry import CalledOff, pause, retry_while_unavailable
from core.settings import WorkerSettings
from worker.host import device_health
from worker.host.device import device_of
from worker.host.device_lock import slot_names
from worker.host.disk import has_room, what_to_do
from worker.host.drain_flag import Draining
from worker.host.parent_death import die_with_parent
from worker.preview.drawing import draw
from worker.supervision.spool import SPOOLS, remove_left_over, spool
from worker.supervision.supervisor import Supervisor
from worker.validation.confined import validate

log = structlog.get_logger()

# How long a worker that cannot start a job leaves the queue to others.
_PAUSE_S = 5.0


def run_attempt(job_id: str, attempt: int) -> None:
    """Claim the attempt and see it to its end; an outdated dispatch does nothing."""
    draining = Draining()
    signal.signal(signal.SIGTERM, draining.set)
    # The work-horse of a killed worker ends, too, but drains first: SIGTERM, not SIGKILL.
    die_with_parent(signal_number=signal.SIGTERM)
    structlog.contextvars.bind_contextvars(job_id=job_id, attempt=attempt)
    settings = read(WorkerSettings)
    remove_left_over(settings.data_dir / SPOOLS)  # They may be what fills the disk.
    if not has_room(settings.data_dir):
        _leave_to_others(what_to_do(settings.data_dir), draining)
        return
    try:
        device = device_of(settings.device)
        places = slot_names(device, os.getppid())
    except Misconfigured as error:  # A GPU has gone since the worker started.
        _leave_to_others(error.detail, draining)
        return
    store = job_store(settings)
    worker = this_worker() or f"{socket.gethostname()}:{device}"
    take = partial(
        claim_attempt,
        job_id,
        attempt,
        worker=worker,
        store=store,
        objects=object_store(settings),
        lease=settings.lease,
        secret=new_secret(),
    )
    try:
        job = retry_while_unavailable(partial(store.get, job_id), called_off=draining.is_set)
        look = partial(_why_left_to_others, job, store)
        if reason := retry_while_unavailable(look, called_off=draining.is_set):
            # The reconciler dispatches it again after it has missed it twice.
            log.info("left_to_others", detail=reason)
            return
        claim = retry_while_unavailable(take, called_off=draining.is_set)
    except (CalledOff, NotFound, JobUnreadable) as error:
        log.info("dispatch_ignored", error=str(error))
        return
    if claim is None:
        log.info("dispatch_ignored")
        return
    test = device_health.command_for(device)
    Supervisor(claim, settings, device, places, draining=draining, device_test=test).run()


def validate_model(model_id: str) -> None:
    """Examine a model that somebody has sent; skip one that was deleted meanwhile."""
    die_with_parent(signal_number=signal.SIGTERM)
    settings = read(WorkerSettings)
    spools = settings.data_dir.absolute() / SPOOLS
    store = job_store(settings)
    with spool(spools / f"{model_id.replace(':', '-')}.{os.getpid()}") as folder, suppress(NotFound):
        validate(
            model_id,
            store,
            object_store(settings),
            folder,
            settings.data_dir.absolute(),
            strictly=settings.models == "confined",
            is_wanted=partial(_a_job_waits, store),
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


def _why_left_to_others(job: Job, store: JobStore) -> str | None:
    return why_left_to_others(job, packages_here(), store.workers())


def _leave_to_others(reason: str, draining: Draining) -> None:
    """Claim nothing: the reconciler dispatches the job again, to the first worker that is free."""
    log.error("no_job_begun", detail=reason)
    with suppress(CalledOff):
        pause(_PAUSE_S, draining.is_set)
