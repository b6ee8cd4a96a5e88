"""A cohort, from outside: one process that trains several claimed jobs, and a supervisor for each of them."""

import os
import socket
import sys
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from subprocess import Popen, TimeoutExpired
from typing import IO

import structlog

from core.jobs.attempts import Claim
from core.jobs.spec import EnvironmentSpec
from core.settings import WorkerSettings
from worker.compile_cache.session import Caches
from worker.host.child import TRAINING, environment, kill, launch, tail
from worker.host.device_lock import slots
from worker.host.drain_flag import Draining
from worker.host.memory import sacrifice
from worker.supervision.seat import Seat
from worker.supervision.spool import SPOOLS, private, spool
from worker.supervision.supervisor import Supervisor

log = structlog.get_logger()

COHORT = (sys.executable, "-m", "worker.training.cohort")
# The end of what the process printed, for the worker's log where it failed.
_LOGGED_BYTES = 4000
# How long the process may take to exit when no member is left.
_END_S = 10.0


@dataclass
class Cohort:
    """Runs claimed attempts at jobs that can train together (`core.jobs.cohort`).

    Each job has its own supervisor, training process, lease and files, as if it trained alone; only the
    numbers come from the cohort's process, which has the device. Afterwards every job has ended or is back in
    the queue, and no process and no spool is left. device_test: as for `Supervisor`.
    """

    claims: Sequence[Claim]
    environment: EnvironmentSpec
    settings: WorkerSettings
    device: str
    slot_names: tuple[str, ...]
    command: Sequence[str] = COHORT
    member_command: Sequence[str] = TRAINING
    draining: Draining = field(default_factory=Draining)
    device_test: Sequence[str] | None = None

    def run(self) -> None:
        pairs = [socket.socketpair() for _ in self.claims]
        ready: Future[None] = Future()
        seats = [Seat(own.detach(), ready, len(pairs)) for own, _ in pairs]
        theirs = [other.detach() for _, other in pairs]
        with ThreadPoolExecutor(len(self.claims), "supervisor") as threads:
            # They keep the leases while the cohort's process waits for the device.
            supervised = [
                threads.submit(self._supervise, number, claim, seat)
                for number, (claim, seat) in enumerate(zip(self.claims, seats, strict=True))
            ]
            with ExitStack() as held:
                try:
                    self._start(held, theirs)
                except BaseException as error:
                    ready.set_exception(error)
                else:
                    ready.set_result(None)
                finally:
                    for descriptor in theirs:  # The process has them: its end is the connections' end.
                        os.close(descriptor)
                for future in supervised:
                    future.exception()  # Waits. What it says is raised below, when no process is left.
        for future in supervised:
            future.result()

    def _supervise(self, number: int, claim: Claim, seat: Seat) -> None:
        test = self.device_test if number == 0 else None  # Once is enough.
        command, draining = self.member_command, self.draining
        try:
            Supervisor(
                claim, self.settings, self.device, self.slot_names, command, draining, test, seat
            ).run()
        finally:
            seat.leave()

    def _start(self, held: ExitStack, descriptors: Sequence[int]) -> None:
        """Start the process, which ends when `held` does. Raises SlotTaken, CalledOff."""
        folder, first = self.settings.data_dir.absolute(), self.claims[0]
        leaving = self.draining.is_set
        own = held.enter_context(spool(folder / SPOOLS / f"cohort-{first.job_id}.{first.number}"))
        locks = [folder / "locks" / f"{name}.lock" for name in self.slot_names]
        slot_fds = held.enter_context(slots(locks, self.settings.grace.total_seconds(), leaving))
        caches = Caches(first.objects, self.settings, self.device, own, private(own))
        caches.open(self.environment, leaving)
        output = held.enter_context((own / "output").open("w+b"))
        process = launch(
            [*self.command, *map(str, descriptors)],
            environment(self.device, folder, os.environ),
            stdout=output,
            cwd=own,
            fds=(*descriptors, *slot_fds),
        )
        held.callback(self._end, process, output, caches)
        sacrifice(process.pid)
        log.info("cohort_started", jobs=[claim.job_id for claim in self.claims])

    def _end(self, process: "Popen[bytes]", output: IO[bytes], caches: Caches) -> None:
        """By now every member has left; a process that hangs is killed."""
        with suppress(TimeoutExpired):
            process.wait(_END_S)
        status = process.poll()
        kill(process)
        if status == 0:
            caches.keep()
            caches.close(self.draining.is_set)
        elif not self.draining.is_set():
            log.error("cohort_failed", status=status, output=tail(output, _LOGGED_BYTES))
