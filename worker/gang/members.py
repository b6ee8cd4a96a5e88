"""The gang as the worker of rank 0 sees it: which hosts have joined.

The worker waits until all members are connected, and then takes a job. Its work-horse inherits the
connections by the fork and speaks over them for one attempt; the worker then closes them, and the members
connect again.
"""

import errno
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from ipaddress import ip_address

import structlog
from pydantic import ValidationError

from core.devices import gpu_indices
from core.errors import Misconfigured
from core.variables import variable
from worker.gang.connection import Connection, ConnectionLost, Greeting
from worker.gang.messages import (
    GANG_MESSAGE,
    Alive,
    Ended,
    GangMessage,
    Joined,
    Refused,
    encoded,
    versions_here,
)
from worker.gang.place import Place

log = structlog.get_logger()

_POLL_S = 0.02
_SILENT_S = 5.0
# Strangers that may be greeted at the same time.
_MOST_GREETINGS = 100


@dataclass
class Member:
    """The worker of another host, and how its part of the attempt ended. lost: why nothing is heard of it."""

    rank: int
    host: str
    connection: Connection
    lost: str | None = None
    ended: Ended | None = None

    def messages(self) -> Iterator[GangMessage]:
        """Those that have come. A connection that is lost has no more."""
        try:
            for frame in self.connection.received():
                yield GANG_MESSAGE.validate_json(frame)
        except (ConnectionLost, ValidationError) as error:
            self.lost = self.lost or str(error)

    def send(self, message: GangMessage) -> None:
        try:
            self.connection.send(encoded(message))
        except ConnectionLost as error:
            self.lost = self.lost or str(error)


class Gang:
    """The members that are connected. Made once, by the worker, which listens from then on.

    refused: a sentence on the last host that did not fit; empty since another one has joined. Raises
    Misconfigured if the address cannot be listened at.
    """

    def __init__(self, place: Place, device: str) -> None:
        self.place = place
        self._num_gpus = len(gpu_indices(device))
        self._listener = _listener(place)
        self._greetings: list[Greeting] = []
        self._unnamed: list[Connection] = []
        self._members: dict[int, Member] = {}
        self.refused = ""

    @property
    def port(self) -> int:
        return self._listener.getsockname()[1]

    @property
    def members(self) -> Sequence[Member]:
        return [self._members[rank] for rank in sorted(self._members)]

    @property
    def problem(self) -> str | None:
        """A sentence on the hosts that are missing; None if all are there."""
        missing = [rank for rank in range(1, self.place.hosts) if rank not in self._members]
        if not missing:
            return None
        which = f"rank {', '.join(map(str, missing))}"
        there = self.place.hosts - len(missing)
        return f"{there} of {self.place.hosts} hosts are here; missing: {which}. {self.refused}".rstrip()

    def look(self) -> bool:
        """Greet who has come, forget who has gone; whether all are here. Call it repeatedly: none waits."""
        with suppress(BlockingIOError, ConnectionAbortedError):
            while len(self._greetings) < _MOST_GREETINGS:
                self._greetings.append(Greeting(self._listener.accept()[0], self.place.secret))
        for greeting in list(self._greetings):
            self._greet(greeting)
        for connection in list(self._unnamed):
            self._name(connection)
        for member in self.members:
            if any(isinstance(message, Ended) for message in list(member.messages())):
                member.lost = "its worker shuts down"
            if member.lost:
                log.warning("host_left", rank=member.rank, host=member.host, why=member.lost)
                self._drop(member)
        return self.problem is None

    def answers(self) -> bool:
        """Whether every member answers within a few seconds."""
        for member in self.members:
            member.send(Alive())
        asked_at = time.monotonic()
        waiting = list(self.members)
        while waiting and time.monotonic() - asked_at < _SILENT_S:
            waiting = [m for m in waiting if not any(isinstance(said, Alive) for said in m.messages())]
            if any(member.lost for member in waiting):
                break
            time.sleep(_POLL_S)
        return not waiting and self.problem is None

    def release(self) -> None:
        """Close the members' connections, after an attempt: they connect again."""
        for member in self.members:
            self._drop(member)

    def close(self) -> None:
        self.release()
        for one in (*self._greetings, *self._unnamed, self._listener):
            one.close()

    def _greet(self, greeting: Greeting) -> None:
        try:
            connection = greeting.go_on()
        except ConnectionLost as error:
            log.warning("host_not_greeted", why=str(error))
            greeting.close()
            self._greetings.remove(greeting)
            return
        if connection is not None:
            self._greetings.remove(greeting)
            self._unnamed.append(connection)

    def _name(self, connection: Connection) -> None:
        member = Member(-1, "", connection)
        joined = next(member.messages(), None)
        if joined is None and not member.lost:
            return
        self._unnamed.remove(connection)
        if not isinstance(joined, Joined):
            connection.close()
        elif why := self._unfit(joined):
            log.warning("host_refused", rank=joined.rank, host=joined.host, why=why)
            self.refused = f"{joined.host} was refused: {why}"
            member.send(Refused(why=why))
            connection.close()
        else:
            if (before := self._members.get(joined.rank)) is not None:
                self._drop(before)
            member.rank, member.host, self.refused = joined.rank, joined.host, ""
            self._members[joined.rank] = member
            member.send(Alive())
            log.info("host_joined", rank=joined.rank, host=joined.host)

    def _unfit(self, joined: Joined) -> str | None:
        if not 0 < joined.rank < self.place.hosts:
            return f"its rank is {joined.rank}, and the gang has {self.place.hosts} hosts."
        if joined.num_gpus != self._num_gpus:
            return f"it has {joined.num_gpus} GPUs for the job, and the first host has {self._num_gpus}."
        here = versions_here()
        for name, had in joined.versions.items():
            if had != here.get(name):
                return f"it has {name} {had}, and the first host {here.get(name)}."
        return None

    def _drop(self, member: Member) -> None:
        member.connection.close()
        self._members.pop(member.rank, None)


# The gang of this worker: RQ calls a task by its name, in a fork that finds the gang here.
_of_this_worker: list[Gang] = []


def set_gang(gang: Gang) -> None:
    _of_this_worker[:] = [gang]


def gang_here() -> Gang | None:
    return _of_this_worker[0] if _of_this_worker else None


def _listener(place: Place) -> socket.socket:
    """At the named address if it is the loopback, otherwise at all: its name may mean another one here."""
    with suppress(ValueError):
        if ip_address(place.host).is_loopback:
            return _listening(
                place.host, place.port, socket.AF_INET6 if ":" in place.host else socket.AF_INET
            )
    return _listening("", place.port, socket.AF_INET)


def _listening(host: str, port: int, family: int) -> socket.socket:
    try:
        listener = socket.create_server((host, port), family=family)
    except OSError as error:
        taken = " Another program has this port." if error.errno == errno.EADDRINUSE else ""
        raise Misconfigured(
            f"{variable('coordinator')}: port {port} cannot be opened: {error}.{taken}"
        ) from None
    listener.setblocking(False)
    return listener


def plain_address(host: str) -> str:
    """As a part of `host:port`."""
    return f"[{host}]" if ":" in host else host
