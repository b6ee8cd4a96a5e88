"""The reconciler as a process: every few seconds unfinished jobs, every hour models. Composition root."""

import math
import os
import signal
import sys
import time

import structlog

from core.adapters.connect import job_queue, job_store, object_store
from core.adapters.startup import check_stores
from core.configuration import read, stopping_if_misconfigured
from core.errors import Unavailable
from core.jobs.job import utc_now
from core.jobs.reconciliation import reconcile
from core.models import library
from core.settings import ReconcilerSettings
from core.telemetry import configure_logging
from worker.alive import show_life
from worker.lifeline import die_with_parent

log = structlog.get_logger()

# It reads the record of every model, and nobody waits for it.
_TIDY_EVERY_S = 3600.0


@stopping_if_misconfigured()
def main() -> None:
    """Reconcile until a SIGTERM."""
    for number in (signal.SIGTERM, signal.SIGINT):
        # It may be left at any point: whoever looks next does what was left.
        signal.signal(number, lambda number, frame: sys.exit(0))
    if parent := os.environ.get("GAITWAY_PARENT"):
        die_with_parent(int(parent))
    configure_logging("reconciler")
    settings = read(ReconcilerSettings)
    check_stores(settings)
    store, queue, objects = job_store(settings), job_queue(settings), object_store(settings)
    tidied = -math.inf
    while True:
        try:
            reconcile(
                store=store,
                queue=queue,
                objects=objects,
                lease=settings.lease,
                now=utc_now(),
            )
            show_life(settings.alive_file)
            if time.monotonic() - tidied >= _TIDY_EVERY_S:
                num_forgotten = library.tidy(objects=objects, queue=queue, now=utc_now())
                log.info("models_tidied", num_forgotten=num_forgotten)
                tidied = time.monotonic()
        except Unavailable as error:
            log.warning("reconciliation_missed", error=error.detail)
        time.sleep(settings.reconcile_every.total_seconds())


if __name__ == "__main__":
    main()
