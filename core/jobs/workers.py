"""The reports of workers on themselves, and the store that keeps them."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Literal, Protocol

from core.documents import Stored

# A worker names itself by its host, its device and a few random digits.
WORKER_NAME = "[!-~]{1,200}"
WorkerState = Literal["ready", "testing", "device_failed"]


class WorkerInfo(Stored):
    """A worker's report on itself, which it sends at every heartbeat.

    job: the one that it took from the queue. jobs: all whose attempts it runs now; no report names them, the
    store adds them. state: a `ready` worker takes jobs or has one; it takes none while it tests its device,
    or after that has failed a test. problem: a sentence on that failure. memory_bytes: of each of its
    devices, where known. packages: the optional packages that it has; null if a worker of an older version
    did not report them.
    """

    name: str
    host: str
    pid: int
    device: str
    queues: tuple[str, ...] = ()
    job: str | None = None
    jobs: tuple[str, ...] = ()
    state: WorkerState = "ready"
    problem: str | None = None
    memory_bytes: int | None = None
    packages: tuple[str, ...] | None = None
    started_at: datetime
    seen_at: datetime


@dataclass(frozen=True)
class WorkerPage:
    """Some workers by their names, and the cursor of the next page; None at the end."""

    workers: Sequence[WorkerInfo]
    next_cursor: str | None


class WorkerStore(Protocol):
    """Part of the record. Every method raises RecordsUnavailable when the store cannot be reached."""

    def announce(self, worker: WorkerInfo, ttl: timedelta) -> None:
        """Store the report, in place of the one before; it counts for `ttl`."""
        ...

    def withdraw(self, name: str) -> None:
        """Forget a worker that has gone."""
        ...

    def workers(self) -> Sequence[WorkerInfo]:
        """All of them, ordered by name. A report that this version cannot read is left out."""
        ...

    def list_workers(self, *, cursor: str | None = None, limit: int = 50) -> WorkerPage:
        """Some of them, ordered by name. cursor: that of an earlier page; Rejected for any other.

        A report that this version cannot read counts and is left out, so a page may have fewer than `limit`.
        """
        ...
