"""What RQ calls, in a work-horse of its own for each attempt."""

import os
import signal
import socket
import threading
import time

import structlog

from core.adapters.connect import job_store, object_store
from core.configuration import read
from core.jobs.attempts import claim
from core.jobs.job import utc_now
from core.settings import WorkerSettings
from worker.device import device_of
from worker.disk import has_room, what_to_do
from worker.lifeline import die_with_parent
from worker.slot import slot_name
from worker.supervisor import Supervisor

log = structlog.get_logger()

# A worker without room leaves what is queued to others, before it looks again.
_PAUSE_S = 5.0


def run_attempt(job_id: str, attempt: int) -> None:
    """Claim the attempt and see it to its end; a dispatch that is no longer true does nothing."""
    draining = threading.Event()
    signal.signal(signal.SIGTERM, lambda number, frame: draining.set())
    # A worker that is killed takes its work-horse along, and that one drains: SIGTERM, not SIGKILL.
    die_with_parent(signal_number=signal.SIGTERM)
    structlog.contextvars.bind_contextvars(job_id=job_id, attempt=attempt)
    settings = read(WorkerSettings)
    if not has_room(settings.data_dir):
        # Nothing is claimed: the reconciler dispatches the job again, to whoever comes first.
        log.error("no_job_begun", detail=what_to_do(settings.data_dir))
        time.sleep(_PAUSE_S)
        return
    device = device_of(settings)
    worker = f"{socket.gethostname()}:{device}"
    holding = claim(
        job_id,
        attempt,
        worker,
        store=job_store(settings),
        objects=object_store(settings),
        lease=settings.lease,
        now=utc_now(),
    )
    if holding is None:
        log.info("dispatch_ignored")
        return
    Supervisor(holding, settings, device, slot_name(device, os.getppid()), draining=draining).run()
