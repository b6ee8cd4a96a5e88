"""The parts of an attempt on the other hosts of a gang, as the supervisor of rank 0 sees them."""

import re
import signal
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from core.jobs.status import JobStatus
from core.reasons import Reason
from worker.gang.connection import MOST_BYTES, ConnectionLost
from worker.gang.members import Gang, Member, plain_address
from worker.gang.messages import Alive, Begin, Ended, Leaving, Over, Printed
from worker.protocol import GangPart, Task
from worker.supervision.outcome import Outcome, judge

_ALIVE_EVERY_S = 1.0
# A member ends its process by SIGKILL, which takes moments.
_END_S = 15.0
_POLL_S = 0.02
# Reasons that the death of a process on another host can look like.
_CONSEQUENCES = (Reason.TRAINING_CRASHED, Reason.DEVICE_FAILED, Reason.NATIVE_CRASH, Reason.TRAINING_KILLED)
_OF_ANOTHER = re.compile(r"gloo|nccl|coordination|connection|socket|heartbeat|barrier", re.IGNORECASE)


@dataclass
class OtherHosts:
    """The members' parts of one attempt. gang: None where one host has the job. printed: takes their lines
    for the job's log. silent_s: how long a member may say nothing."""

    gang: Gang | None
    printed: Callable[[str], None]
    silent_s: float
    is_leaving: bool = field(default=False, init=False)
    _told_at: float = field(default=0.0, init=False)
    _is_killed: bool = field(default=False, init=False)

    @property
    def _members(self) -> Sequence[Member]:
        return [] if self.gang is None else self.gang.members

    def begin(self, spool: Path) -> None:
        """Send every member its task and the files for it; and add the leader's part to its own task."""
        if self.gang is None:
            return
        task = Task.model_validate_json((spool / "task.json").read_bytes())
        parts = (task.checkpoint, task.model, task.decoder, *task.clips.values())
        names = [name for name in parts if name]
        hosts, port = self.gang.place.hosts, _free_port()
        for member in self._members:
            part = GangPart(hosts=hosts, rank=member.rank, coordinator=f":{port}")
            self.printed(f"[{member.host}, rank {member.rank}] takes part")
            own = task.model_copy(update={"gang": part, "best": ()})
            member.send(Begin(task=own, files={name: (spool / name).stat().st_size for name in names}))
            for name in names:
                _send_file(member, spool / name)
        addresses = {plain_address(member.connection.own_host) for member in self._members}
        address = f"{sorted(addresses)[0]}:{port}"
        bind = address if len(addresses) == 1 else None
        part = GangPart(hosts=hosts, rank=0, coordinator=address, bind=bind)
        (spool / "task.json").write_text(task.model_copy(update={"gang": part}).model_dump_json())
        now = time.monotonic()
        for member in self._members:
            member.connection.heard_at = now

    def what_is_wrong(self, group: int = 0) -> str | None:
        """A sentence once a member's part has failed or is lost; looks without waiting. group: not used."""
        if (now := time.monotonic()) - self._told_at >= _ALIVE_EVERY_S:
            self._told_at = now
            for member in self._members:
                member.send(Alive())
        self._read()
        for member in self._members:
            silent_s = now - member.connection.heard_at
            if member.ended is None and silent_s > self.silent_s:
                member.lost = member.lost or f"it was silent for {silent_s:.0f} s"
        wrong = next((m for m in self._members if (m.ended.status if m.ended else m.lost)), None)
        if wrong is None:
            return None
        self._is_killed = True
        return f"The part of the job on {wrong.host} (rank {wrong.rank}) has ended."

    def end(self) -> None:
        """End every member's part; returns when all have, or are lost, or after some seconds."""
        for member in self._members:
            member.send(Over())
        until = time.monotonic() + _END_S
        while any(m.ended is None and m.lost is None for m in self._members):
            if time.monotonic() > until:
                break
            self._read()
            time.sleep(_POLL_S)
        for member in self._members:
            if member.ended is None:
                member.lost = member.lost or f"it did not answer for {_END_S:.0f} s"

    def outcome(self, own: Outcome) -> Outcome:
        """The attempt's outcome, after `end`. own: that of the leader's process, which may have ended only
        because another had."""
        if not self._members or own.status not in (None, JobStatus.FAILED):
            return own
        if own.reason not in _CONSEQUENCES:
            return own
        for member in self._members:
            where = f"On {member.host} (rank {member.rank}): "
            ended = member.ended
            if ended is None:
                message = f"The host {member.host} (rank {member.rank}) is lost: {member.lost}."
                return Outcome(
                    None, Reason.WORKER_LOST, f"{message} The job resumes from its last checkpoint."
                )
            if ended.is_stopped or not ended.status or _is_consequence(ended):
                continue
            told = judge(ended.failure, ended.status, None, 0.0)
            return Outcome(told.status, told.reason, where + told.message)
        if self._is_killed or _OF_ANOTHER.search(own.message):
            message = "The hosts lost touch with each other. The job resumes from its last checkpoint."
            return Outcome(None, Reason.WORKER_LOST, message)
        return own

    def _read(self) -> None:
        for member in self._members:
            for message in member.messages():
                match message:
                    case Printed(text=text):
                        self.printed(f"[{member.host}, rank {member.rank}] {text}")
                    case Leaving():
                        self.is_leaving = True
                    case Ended():
                        member.ended = message
                    case _:
                        pass


def _is_consequence(ended: Ended) -> bool:
    """Whether a process may have ended only because another one had."""
    if ended.failure is None:
        return ended.status == -signal.SIGABRT or ended.status > 0
    return ended.failure.reason in _CONSEQUENCES and bool(_OF_ANOTHER.search(ended.failure.message))


def _send_file(member: Member, path: Path) -> None:
    with path.open("rb") as file, suppress(ConnectionLost):
        while piece := file.read(MOST_BYTES):
            member.connection.send(piece)


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("", 0))
        return one.getsockname()[1]
