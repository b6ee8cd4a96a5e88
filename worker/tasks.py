"""What RQ calls, in a work-horse of its own for each attempt."""

import os
import signal
import socket
import threading

import structlog

from core.adapters.connect import job_store, object_store
from core.configuration import read
from core.jobs.attempts import claim
from core.jobs.job import utc_now
from core.settings import WorkerSettings
from worker.device import device_of
from worker.lifeline import die_with_parent
from worker.supervisor import Supervisor

log = structlog.get_logger()


def run_attempt(job_id: str, attempt: int) -> None:
    """Claim the attempt and see it to its end; a dispatch that is no longer true does nothing."""
    draining = threading.Event()
    signal.signal(signal.SIGTERM, lambda number, frame: draining.set())
    # A worker that is killed takes its work-horse along, and that one drains: SIGTERM, not SIGKILL.
    die_with_parent(signal_number=signal.SIGTERM)
    structlog.contextvars.bind_contextvars(job_id=job_id, attempt=attempt)
    settings = read(WorkerSettings)
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
    # A GPU is one slot for the whole machine; CPU workers may share the cores, one job each.
    slot_name = f"cpu-{os.getppid()}" if device == "cpu" else device.replace(":", "-")
    Supervisor(holding, settings, device, slot_name, draining=draining).run()
