"""How a cohort's process answers its members, with a run that is played."""

import threading
from collections.abc import Iterator
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from core.algorithms.events import Progress
from core.errors import JobFailed
from core.reasons import Reason
from worker.training.cohort.messages import Begun, Request, unpack
from worker.training.cohort.serve import _Members

BEGUN = Begun(device="cpu", engine="native", engine_reason="", total=100, num_members=2)


class PlayedRun:
    """A run of a hundred epochs, each of which waits until the test lets it end. diverge: in the first."""

    def __init__(self, diverge: set[int]) -> None:
        self.failed: set[int] = set()
        self.epochs = 0
        self.may_end = threading.Semaphore(0)
        self._diverge = diverge

    def step(self, member: int) -> int:
        return self.epochs

    def moments(self) -> Iterator[list[tuple[int, Any]]]:
        for _ in range(100):
            self.may_end.acquire()
            self.epochs += 1
            here = {0, 1} - self.failed
            self.failed = self._diverge
            failure, seen = JobFailed(Reason.DIVERGED, "NaN."), Progress(self.epochs, 100, {})
            yield [(one, failure if one in self.failed else seen) for one in sorted(here)]

    def checkpoint(self, member: int) -> bytes:
        return b"checkpoint %d" % member

    def policy(self, member: int) -> bytes:
        return b"policy"


class Served:
    """A process that serves, in a thread, and the ends of its members."""

    def __init__(self, diverge: set[int]) -> None:
        self.run = PlayedRun(diverge)
        pairs = [Pipe() for _ in range(2)]
        self.first, self.second = (theirs for _, theirs in pairs)
        members = _Members(self.run, [ours for ours, _ in pairs])  # type: ignore[arg-type]
        self.thread = threading.Thread(target=members.see_to_the_end, args=(BEGUN,), daemon=True)
        self.thread.start()
        for member in (self.first, self.second):
            assert Begun.model_validate_json(member.recv_bytes()) == BEGUN
            member.send_bytes(Request.NEXT)
        self.run.may_end.release()

    def ends(self) -> bool:
        self.thread.join(10)
        return not self.thread.is_alive()


def answer(member: Connection, request: Request) -> bytes:
    member.send_bytes(request)
    assert member.poll(10), "nobody answers"
    return member.recv_bytes()


def test_a_diverged_member_is_answered_when_the_others_have_left_and_the_training_stops() -> None:
    """M8: it was answered at the end of the whole budget."""
    served = Served({1})
    assert unpack(served.first.recv_bytes()).seen == Progress(1, 100, {})
    assert isinstance(unpack(served.second.recv_bytes()).seen, JobFailed)
    served.first.close()
    served.run.may_end.release()  # At most one epoch is trained for nobody.
    assert answer(served.second, Request.CHECKPOINT) == b"checkpoint 1"
    assert answer(served.second, Request.POLICY) == b"policy"
    served.second.close()
    assert served.ends()
    assert served.run.epochs <= 2


def test_a_diverged_member_is_answered_while_the_others_train() -> None:
    """M8."""
    served = Served({1})
    served.first.recv_bytes()
    served.second.recv_bytes()
    served.second.send_bytes(Request.CHECKPOINT)
    served.first.send_bytes(Request.NEXT)
    served.run.may_end.release()
    assert unpack(served.first.recv_bytes()).step == 2
    assert served.second.poll(10)
    assert served.second.recv_bytes() == b"checkpoint 1"
    for member in (served.first, served.second):
        member.close()
    served.run.may_end.release()
    assert served.ends()


def test_when_all_have_diverged_each_is_told_and_the_training_stops() -> None:
    """M8."""
    served = Served({0, 1})
    for member in (served.first, served.second):
        assert isinstance(unpack(member.recv_bytes()).seen, JobFailed)
        assert answer(member, Request.CHECKPOINT).startswith(b"checkpoint")
        member.close()
    assert served.ends()
    assert served.run.epochs == 1
