"""The reconciler process: unfinished jobs and feeds every second, the rest every hour; it sends news, too.
Composition root.

When it starts, it also creates the database's tables or brings them up to date.
"""

import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import structlog

from core.adapters.startup import check_stores, prepare_database, prepare_workers
from core.adapters.wiring import job_queue, job_store, object_store
from core.configuration import read, stopping_if_misconfigured
from core.errors import Unavailable
from core.jobs import feeds, orphans, removal
from core.jobs.ending import end_deletions
from core.jobs.reconciliation import Reconciler, StrayMessages
from core.jobs.store import JobStore
from core.jobs.tallies import Report, Tallies
from core.settings import ReconcilerSettings
from core.storage.objects import ObjectStore
from core.sweeps.controller import SweepController
from core.telemetry import configure_logging
from core.uploads import library
from core.uploads.record import UploadStore
from worker.host.health import show_life
from worker.news import Post, Sender

log = structlog.get_logger()

# It reads the record of every model and clip file, and nobody waits for it.
_TIDY_EVERY_S = 3600.0
_DELETIONS_EVERY_S = 60.0
_REPORT_EVERY_S = 30.0
# How long a pass may spend on a chore that takes minutes.
_AT_ONCE_S = 0.2


@dataclass
class Chore:
    """Something to be done repeatedly. An outage or a bug delays it, but no other chore."""

    name: str
    every_s: float
    do: Callable[[], object]
    done_at: float = field(default=-math.inf, init=False)

    def do_if_due(self) -> None:
        if time.monotonic() - self.done_at < self.every_s:
            return
        try:
            self.do()
        except Unavailable as error:
            log.warning("reconciliation_missed", chore=self.name, error=error.detail)
        except Exception:  # A bug, or one damaged row, must not end the reconciler.
            log.exception("chore_failed", chore=self.name)
            self.done_at = time.monotonic()
        else:
            self.done_at = time.monotonic()


@dataclass
class LongChore:
    """A chore that takes minutes, done a little in each pass, so that nothing urgent waits for its end.

    begin: returns an iterator that does one step per item.
    """

    name: str
    every_s: float
    begin: Callable[[], Iterator[object]]
    done_at: float = field(default=-math.inf, init=False)
    _steps: Iterator[object] | None = field(default=None, init=False)

    def do_if_due(self) -> None:
        if self._steps is None and time.monotonic() - self.done_at < self.every_s:
            return
        until = time.monotonic() + _AT_ONCE_S
        try:
            self._steps = self._steps or self.begin()
            while time.monotonic() < until:
                next(self._steps)
        except StopIteration:
            self._steps, self.done_at = None, time.monotonic()
        except Unavailable as error:  # It begins again in the next pass.
            self._steps = None
            log.warning("reconciliation_missed", chore=self.name, error=error.detail)
        except Exception:  # As above; what would follow waits for the next time.
            self._steps, self.done_at = None, time.monotonic()
            log.exception("chore_failed", chore=self.name)


def chores(settings: ReconcilerSettings) -> Sequence[Chore | LongChore]:
    """All chores, the urgent one first."""
    tallies = Tallies()
    observe = tallies.observe_store
    store, queue = job_store(settings, observe=observe), job_queue(settings, observe=observe)
    objects = object_store(settings, observe=observe)
    every_s = settings.reconcile_every.total_seconds()
    return [
        Chore("jobs", every_s, Reconciler(store, queue, settings.lease).run_once),
        Chore("feeds", every_s, partial(feeds.compact, store=store, objects=objects)),
        Chore("sweeps", every_s, SweepController(store, queue, objects).run_once),
        Chore("messages", 10 * every_s, StrayMessages(queue).run_once),
        Chore("monitoring", _REPORT_EVERY_S, Report(tallies, store.add_tallies).now),
        Chore("half_life", _TIDY_EVERY_S, partial(store.set_half_life, settings.share_half_life)),
        Chore("record", _TIDY_EVERY_S, store.tidy),
        *(
            Chore(f"refused_{uploads.kind.name}", _TIDY_EVERY_S, partial(_tidy, uploads, store, objects))
            for uploads in (store.models, store.clips)
        ),
        Chore("deletions", _DELETIONS_EVERY_S, partial(end_deletions, store=store, objects=objects)),
        Chore("uploads", _TIDY_EVERY_S, partial(orphans.end_unfinished, store=store, objects=objects)),
        LongChore("retention", _TIDY_EVERY_S, partial(removal.apply, store=store, objects=objects)),
        LongChore("orphans", _TIDY_EVERY_S, partial(orphans.sweep, store=store, objects=objects)),
    ]


@stopping_if_misconfigured()
def main() -> None:
    """Reconcile until a SIGTERM."""
    for number in (signal.SIGTERM, signal.SIGINT):
        # It may stop at any point: the next pass does what was left.
        signal.signal(number, lambda number, frame: sys.exit(0))
    configure_logging("reconciler")
    settings = read(ReconcilerSettings)
    prepare_database(settings)
    prepare_workers(settings)
    check_stores(settings)
    urgent, *others = chores(settings)
    pause_s = settings.reconcile_every.total_seconds()
    # In a thread: a silent object store delays a chore by a minute, and leases must be watched all the time.
    patient = threading.Thread(target=_go_on, args=(others, pause_s), name="chores", daemon=True)
    patient.start()
    sender = Sender(job_store(settings), Post(settings.news_networks))
    # In another: a webhook must not wait for a chore.
    news = threading.Thread(target=sender.run, name="news", daemon=True)
    news.start()
    # Chores go on after a bug. Should a thread end all the same, the log has the traceback.
    while patient.is_alive() and news.is_alive():
        urgent.do_if_due()
        show_life(settings.alive_file)
        time.sleep(pause_s)
    sys.exit(1)


def _tidy(uploads: UploadStore[Any], store: JobStore, objects: ObjectStore) -> int:
    return library.tidy(store=uploads, objects=objects, now=store.now())


def _go_on(chores: Sequence[Chore | LongChore], pause_s: float) -> None:
    while True:
        for chore in chores:
            chore.do_if_due()
        time.sleep(pause_s)


if __name__ == "__main__":
    main()
