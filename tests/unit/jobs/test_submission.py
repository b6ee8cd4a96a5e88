"""Word that RQ was told reaches the record some at a time, and its loss does no harm."""

from collections.abc import Sequence
from queue import SimpleQueue
from threading import Event, Thread

from structlog.testing import capture_logs

from core.errors import RecordsUnavailable
from core.jobs.store import Dispatch
from core.jobs.submission import Acknowledgements

FIRST, SECOND, THIRD = (Dispatch("attempt", f"job-{number}", 1) for number in range(3))


def test_what_comes_at_once_is_one_write() -> None:
    written: SimpleQueue[Sequence[Dispatch]] = SimpleQueue()
    acknowledgements = Acknowledgements(written.put)
    acknowledgements.add(FIRST)
    acknowledgements.add(SECOND)
    assert written.get(timeout=5) == [FIRST, SECOND]
    acknowledgements.add(THIRD)
    assert written.get(timeout=5) == [THIRD]


def test_an_outage_is_said_and_ends_nothing() -> None:
    written: list[Sequence[Dispatch]] = []

    def write(dispatches: Sequence[Dispatch]) -> None:
        if FIRST in dispatches:
            raise RecordsUnavailable("PostgreSQL does not answer.")
        written.append(dispatches)

    acknowledgements = Acknowledgements(write)
    with capture_logs() as said:
        acknowledgements.add(FIRST)
        acknowledgements.flush()
    assert [(line["event"], line["number"]) for line in said] == [("acknowledgements_dropped", 1)]
    acknowledgements.add(SECOND)
    acknowledgements.flush()
    assert written == [[SECOND]]


def test_a_flush_waits_for_a_write_under_way() -> None:
    begun, may_end, ended = Event(), Event(), Event()

    def write(dispatches: Sequence[Dispatch]) -> None:
        if dispatches:
            begun.set()
            assert may_end.wait(5)
            ended.set()

    acknowledgements = Acknowledgements(write)
    acknowledgements.add(FIRST)
    assert begun.wait(5)  # the timer's own write
    had_ended: SimpleQueue[bool] = SimpleQueue()

    def flush() -> None:
        acknowledgements.flush()
        had_ended.put(ended.is_set())

    Thread(target=flush).start()
    may_end.set()
    assert had_ended.get(timeout=5)
