"""Renews a job's lease while it runs, and notices a cancellation."""

import threading
from typing import Self

import structlog

from core.errors import LeaseLost, Unavailable
from core.jobs.attempts import Claim
from core.jobs.status import JobStatus
from core.settings import WorkerSettings

log = structlog.get_logger()


class Heartbeat:
    """A thread that renews the lease. It waits out an outage of the store; then the token decides."""

    def __init__(self, claim: Claim, settings: WorkerSettings) -> None:
        self.cancelled = threading.Event()
        self.lost = threading.Event()
        self._claim = claim
        self._settings = settings
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _beat(self) -> None:
        while not self._over.is_set() and not self.lost.is_set():
            try:
                status = self._claim.store.renew(self._claim.job_id, self._claim.token, self._settings.lease)
            except Unavailable as error:
                log.warning("heartbeat_missed", error=error.detail)
            except LeaseLost:
                self.lost.set()
            except Exception as error:  # A bug of ours must not cost the job its lease.
                log.error("heartbeat_failed", error=repr(error))
            else:
                if status == JobStatus.CANCELLING:
                    self.cancelled.set()
            self._over.wait(self._settings.heartbeat.total_seconds())
