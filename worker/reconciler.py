"""The reconciler as a process: looks at every unfinished job every few seconds. Composition root."""

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
from core.settings import ReconcilerSettings
from core.telemetry import configure_logging
from worker.alive import show_life
from worker.lifeline import die_with_parent

log = structlog.get_logger()


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
        except Unavailable as error:
            log.warning("reconciliation_missed", error=error.detail)
        time.sleep(settings.reconcile_every.total_seconds())


if __name__ == "__main__":
    main()
