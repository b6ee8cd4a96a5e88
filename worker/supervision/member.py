"""The worker of a host that is not the first of its gang: it runs its part of what the leader begins.

It knows neither the record nor the queue: the leader sends it the task and its files.
"""

import queue
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import structlog
from pydantic import ValidationError

from core.devices import gpu_indices
from core.reasons import Reason
from core.retry import CalledOff, pause
from core.settings import WorkerSettings
from core.storage.objects import ObjectStore
from worker.compile_cache.session import Caches
from worker.gang.connection import Connection, ConnectionLost, connect
from worker.gang.members import plain_address
from worker.gang.messages import (
    GANG_MESSAGE,
    Alive,
    Begin,
    Ended,
    GangMessage,
    Joined,
    Leaving,
    Over,
    Printed,
    Refused,
    encoded,
    versions_here,
)
from worker.gang.place import Place
from worker.host.cgroup import memory_group
from worker.host.child import TRAINING, TrainingProcess
from worker.host.device_health import SUSPICIOUS, DeviceHealth, set_aside
from worker.host.disk import is_full, what_to_do
from worker.host.health import show_life
from worker.host.locks import SlotTaken, slots
from worker.host.memory import MemoryWatch, allowed_bytes
from worker.protocol import Failed, PhaseEnded
from worker.stopping import DRAIN_SIGNAL, Draining
from worker.supervision.spool import SPOOLS, private, remove_left_over, spool
from worker.supervision.watching import LogLimit

log = structlog.get_logger()

_POLL_S = 0.1
_ALIVE_EVERY_S = 1.0
_AGAIN_S, _AGAIN_AFTER_REFUSAL_S = 1.0, 10.0
_NOT_STARTED = "The worker was shut down before it had started."
_COMPILED = ("compile", "first_update")


@dataclass
class GangMember:
    """A member's worker. slot_names: of its device's locks. objects: for what was compiled before. command:
    the training process."""

    place: Place
    settings: WorkerSettings
    device: str
    slot_names: tuple[str, ...]
    objects: ObjectStore
    health: DeviceHealth
    draining: Draining = field(default_factory=Draining)
    command: tuple[str, ...] = TRAINING
    _said: str = field(default="", init=False)
    _joined_at: float = field(default_factory=time.monotonic, init=False)

    def serve(self) -> None:
        """Join the leader and run its attempts, until a drain, or until the leader has been gone for
        GAITWAY_IDLE_EXIT."""
        idle_exit = self.settings.idle_exit
        with suppress(CalledOff):
            while idle_exit is None or time.monotonic() - self._joined_at < idle_exit.total_seconds():
                self._serve_once()

    def _serve_once(self) -> None:
        show_life(self.settings.alive_file)
        remove_left_over(self.settings.data_dir.absolute() / SPOOLS)
        while not self.health.is_fit():
            pause(_POLL_S, self.draining.is_set)
        try:
            connection = connect(self.place.host, self.place.port, self.place.secret)
        except (OSError, ConnectionLost) as error:
            self._say("leader_not_reached", str(error))
            pause(_AGAIN_S, self.draining.is_set)
            return
        try:
            self._join(connection)
            self._follow(connection)
        except (ConnectionLost, ValidationError) as error:
            self._say("leader_left", str(error))
            pause(_AGAIN_S, self.draining.is_set)
        finally:
            connection.close()
            self._joined_at = time.monotonic()

    def _join(self, connection: Connection) -> None:
        joined = Joined(
            rank=self.place.rank,
            host=socket.gethostname(),
            num_gpus=len(gpu_indices(self.device)),
            versions=versions_here(),
        )
        connection.send(encoded(joined))

    def _follow(self, connection: Connection) -> None:
        """Run an attempt. Raises ConnectionLost, and CalledOff at a drain before one has begun here."""
        while True:
            if self.draining.is_set():
                # The leader may have begun one all the same.
                connection.send(encoded(_failed(Reason.WORKER_DRAINED, _NOT_STARTED)))
                raise CalledOff
            show_life(self.settings.alive_file)
            for frame in connection.received():
                match GANG_MESSAGE.validate_json(frame):
                    case Alive():
                        self._say("joined", f"rank {self.place.rank} of {self.place.hosts}")
                        connection.send(encoded(Alive()))
                    case Refused(why=why):
                        self._say("refused_by_leader", why)
                        pause(_AGAIN_AFTER_REFUSAL_S, self.draining.is_set)
                        return
                    case Begin() as begin:
                        MemberAttempt(self, connection, begin).run()
                        return  # The leader closes the connection; the next attempt has a fresh one.
                    case _:
                        pass
            time.sleep(_POLL_S)

    def _say(self, event: str, detail: str) -> None:
        """Log it unless it was the last thing said."""
        if self._said != event + detail:
            self._said = event + detail
            log.info(event, host=self.place.host, port=self.place.port, detail=detail)


@dataclass
class MemberAttempt:
    """A member's part of one attempt. Afterwards the leader knows how it ended, and nothing of it is left."""

    member: GangMember
    connection: Connection
    begin: Begin
    _is_stopped: bool = field(default=False, init=False)
    _is_leaving: bool = field(default=False, init=False)
    _told_at: float = field(default=0.0, init=False)

    def run(self) -> None:
        """Raises ConnectionLost, after its process has ended."""
        task, settings = self.begin.task, self.member.settings
        folder = settings.data_dir.absolute()
        own = folder / SPOOLS / f"{task.job_id}.{task.attempt}.rank{self.member.place.rank}"
        caches = Caches(self.member.objects, settings, self.member.device, own, private(own))
        with structlog.contextvars.bound_contextvars(
            job_id=task.job_id, attempt=task.attempt, correlation_id=task.correlation_id
        ):
            log.info("part_began")
            ended = self._ended(caches, folder, own)
            log.info("part_ended", status=ended.status, is_stopped=ended.is_stopped)
        if ended.failure is not None and ended.failure.reason in SUSPICIOUS:
            with suppress(OSError):
                set_aside(folder, self.member.slot_names, ended.failure.message)
        self.connection.send(encoded(ended))
        caches.close(self.member.draining.is_set)

    def _ended(self, caches: Caches, folder: Path, own: Path) -> Ended:
        try:
            with spool(own):
                self._receive(own)
                return self._trained(caches, folder, own)
        except SlotTaken as error:
            return _failed(Reason.DEVICE_HELD, str(error))
        except CalledOff:
            return _failed(Reason.WORKER_DRAINED, _NOT_STARTED)
        except OSError as error:
            if not is_full(error):
                raise
            return _failed(Reason.STORAGE_UNAVAILABLE, what_to_do(folder))

    def _receive(self, own: Path) -> None:
        """Write the task and its files into the spool."""
        task = self.begin.task
        part = task.gang
        if part is None:
            raise ConnectionLost("the leader began a job of a single host")
        host = plain_address(self.connection.peer_host)
        part = part.model_copy(update={"coordinator": host + part.coordinator})
        task = task.model_copy(update={"gang": part, "device": self.member.device})
        (own / "task.json").write_text(task.model_dump_json())
        frames = self._frames()
        for name, size in self.begin.files.items():
            with (own / Path(name).name).open("wb") as file:
                while file.tell() < size:
                    file.write(next(frames))

    def _frames(self) -> Iterator[bytes]:
        while True:
            yield from self.connection.received()
            self._check_silence()
            pause(0.005, self.member.draining.is_set)

    def _trained(self, caches: Caches, folder: Path, own: Path) -> Ended:
        settings = self.member.settings
        locks = [folder / "locks" / f"{name}.lock" for name in self.member.slot_names]
        leaving = self.member.draining.is_set
        with slots(locks, settings.grace.total_seconds(), leaving) as fds:
            caches.open(self.begin.task.spec.environment, leaving)
            process = TrainingProcess(
                self.member.command, own, folder, self.member.device, fds, settings.models
            )
            try:
                output = _Output(process, caches)
                memory_bytes = allowed_bytes(settings.memory_limit)
                with memory_group(process.pid, memory_bytes) as group:
                    ended = self._watched(process, output, MemoryWatch(memory_bytes, group=group))
            finally:
                process.kill()
        return ended

    def _watched(self, process: TrainingProcess, output: "_Output", memory: MemoryWatch) -> Ended:
        too_much: Failed | None = None
        while (status := process.poll(_POLL_S)) is None:
            show_life(self.member.settings.alive_file)
            self._exchange(process, output)
            if (problem := memory.what_is_wrong(process.pid)) is not None:
                too_much = Failed(reason=Reason.OUT_OF_HOST_MEMORY, message=problem)
                process.kill()
        if memory.ran_out() and status < 0 and not self._is_stopped:
            too_much = Failed(reason=Reason.OUT_OF_HOST_MEMORY, message="The kernel killed it for memory.")
        process.kill()
        output.join()
        self._pass_on(output)
        if status == -DRAIN_SIGNAL and self.member.draining.is_set():  # It came before it was ignored.
            return _failed(Reason.WORKER_DRAINED, _NOT_STARTED)
        if status == 0:
            output.caches.keep()
        return Ended(status=status, failure=too_much or output.failure, is_stopped=self._is_stopped)

    def _exchange(self, process: TrainingProcess, output: "_Output") -> None:
        """Signs of life and lines to the leader; its word that the attempt is over to the process."""
        for frame in self.connection.received():
            if isinstance(GANG_MESSAGE.validate_json(frame), Over) and not self._is_stopped:
                self._is_stopped = True
                process.kill()
        self._check_silence()
        if self.member.draining.is_set() and not self._is_leaving:
            self._is_leaving = True
            self._send(Leaving())
        if self.member.draining.for_s() > self.member.settings.grace.total_seconds():
            process.kill()
        if (now := time.monotonic()) - self._told_at >= _ALIVE_EVERY_S:
            self._told_at = now
            self._send(Alive())
        self._pass_on(output)

    def _pass_on(self, output: "_Output") -> None:
        for line in output.lines():
            self._send(Printed(text=line))

    def _check_silence(self) -> None:
        silent_s = time.monotonic() - self.connection.heard_at
        if silent_s > self.member.settings.lease.total_seconds():
            raise ConnectionLost(f"the leader was silent for {silent_s:.0f} s")

    def _send(self, message: GangMessage) -> None:
        self.connection.send(encoded(message))


class _Output:
    """Two threads that read the process's pipes, so that a full pipe never blocks it."""

    def __init__(self, process: TrainingProcess, caches: Caches) -> None:
        self.failure: Failed | None = None
        self.caches = caches
        self._process = process
        self._lines = queue.SimpleQueue[str]()
        self._threads = [
            threading.Thread(target=target, name=target.__name__, daemon=True)
            for target in (self._read_messages, self._read_lines)
        ]
        for thread in self._threads:
            thread.start()

    def lines(self) -> Iterator[str]:
        """Those that were printed since the last call."""
        with suppress(queue.Empty):
            while True:
                yield self._lines.get_nowait()

    def join(self) -> None:
        for thread in self._threads:
            thread.join()

    def _read_messages(self) -> None:
        for message in self._process.messages():
            if isinstance(message, Failed):
                self.failure = message
            if isinstance(message, PhaseEnded) and message.name in _COMPILED:
                self.caches.keep()

    def _read_lines(self) -> None:
        limit = LogLimit()
        for line in self._process.lines():
            for told in limit.pass_on(line, self._lines.qsize()):
                self._lines.put(told)
        for told in limit.end():
            self._lines.put(told)


def _failed(reason: Reason, message: str) -> Ended:
    return Ended(status=1, failure=Failed(reason=reason, message=message))
