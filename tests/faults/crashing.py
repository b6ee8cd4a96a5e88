"""Stores that fail at one chosen write, and say how many writes there are."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from core.errors import RecordsUnavailable, StorageUnavailable

_WRITES = frozenset(
    {
        *(
            "add",
            "import_job",
            "save",
            "take_back",
            "delete",
            "beat",
            "dispatched",
            "renew",
            "record",
            "replace_by_chunk",
            "deletion_ended",
        ),
        *("replace_chunk", "announce", "withdraw", "tidy"),
        *("add_sweep", "save_sweep", "delete_sweep", "add_trial", "save_trial"),
        *("enqueue", "remove"),
        *("put", "put_file", "put_stream", "delete_prefix"),
    }
)


class Failure(StrEnum):
    """Of a write: it is not made; it is made, and its answer is lost; its process dies right after it."""

    REFUSED = "refused"
    UNANSWERED = "unanswered"
    DEATH = "death"


class Died(BaseException):
    """The process is over: no code of ours catches this."""


@dataclass
class Crash:
    """At which write of a process, the first is 1; 0 is never. num_writes: how many there were."""

    at: int = 0
    failure: Failure = Failure.REFUSED
    num_writes: int = 0
    is_dead: bool = False
    has_happened: bool = False


class Crashing:
    """A store of the record, of objects or of messages, as a process sees it to which the crash happens."""

    def __init__(self, store: Any, crash: Crash, unavailable: type[Exception]) -> None:
        self._store, self._crash, self._unavailable = store, crash, unavailable

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._store, name)

        def call(*arguments: Any, **more: Any) -> Any:
            crash = self._crash
            if crash.is_dead:
                raise Died
            if name not in _WRITES:
                return method(*arguments, **more)
            crash.num_writes += 1
            if crash.num_writes != crash.at:
                return method(*arguments, **more)
            crash.has_happened = True
            if crash.failure is Failure.REFUSED:
                raise self._unavailable("The test refuses this write.")
            method(*arguments, **more)
            if crash.failure is Failure.DEATH:
                crash.is_dead = True
                raise Died
            raise self._unavailable("The test loses this answer.")

        return call


@dataclass(frozen=True)
class Process:
    """The stores and queue that a process of the service works with."""

    store: Any
    objects: Any
    queue: Any

    def crashing(self, crash: Crash) -> "Process":
        return Process(
            Crashing(self.store, crash, RecordsUnavailable),
            Crashing(self.objects, crash, StorageUnavailable),
            Crashing(self.queue, crash, RecordsUnavailable),
        )
