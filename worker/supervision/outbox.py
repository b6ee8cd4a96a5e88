"""Stores what the training process reports, in order, whatever the network does meanwhile."""

import contextlib
import hashlib
import os
import queue
import secrets
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from io import BufferedReader
from itertools import groupby
from pathlib import Path
from threading import Thread

import structlog

from core.algorithms.events import is_of_a_seed
from core.errors import StorageUnavailable
from core.jobs.attempts import Claim
from core.jobs.job import Artifact, Progress, utc_now
from core.jobs.store import Channel, Entry
from core.jobs.tallies import UPLOADED_BYTES, UPLOADS, Tallies
from core.retry import retry_while_unavailable
from core.storage import keys
from worker.host.disk import NotPlain, open_plain
from worker.protocol import (
    Advanced,
    Failed,
    FileReady,
    Finished,
    Hello,
    Measured,
    MemoryPeak,
    Message,
    Noted,
    PhaseBegan,
    PhaseEnded,
    Started,
)
from worker.supervision.story import Story

log = structlog.get_logger()

# How long an object that the record no longer names is kept for those who are reading it.
_DELETE_AFTER_S = 60.0
_POLL_S = 0.1
# The messages that become an entry of the feed and nothing else, and how many go into one write.
_MAX_FEED_MESSAGES = 100
_FEED_MESSAGES = Hello | PhaseBegan | PhaseEnded | Advanced | Measured | Noted
_NO_PROGRESS = Progress()


@dataclass(frozen=True)
class _Received:
    """A message, or a line of the log, and when it came."""

    what: Message | str
    time: datetime


class Outbox:
    """A thread that stores messages and log lines. An outage makes it wait, never the training.

    progress: the job's, from an attempt before. story: tells the log what the messages say. tallies: count
    the uploads.
    """

    def __init__(
        self,
        claim: Claim,
        spool: Path,
        keep_checkpoints: int,
        progress: Progress = _NO_PROGRESS,
        story: Story | None = None,
        tallies: Tallies | None = None,
    ) -> None:
        self._failure: Exception | None = None
        self._is_abandoned = False
        self._claim = claim
        self._spool = spool
        self._keep_checkpoints = keep_checkpoints
        self._progress = progress
        # The newest values that this attempt has measured.
        self._newest: dict[str, float] = {}
        self._story = story
        self._tallies = tallies or Tallies()
        self._dropped: list[tuple[float, str]] = []
        self._waiting: queue.SimpleQueue[_Received | None] = queue.SimpleQueue()
        self._thread = Thread(target=self._work, name="outbox", daemon=True)
        self._thread.start()

    @property
    def num_waiting(self) -> int:
        """The number of messages and lines that are not stored yet."""
        return self._waiting.qsize()

    def put(self, item: Message | str) -> None:
        """Take a message, or a line of the log."""
        if self._story is not None and not isinstance(item, str):
            self.put_all(self._story.lines(item))
        self._waiting.put(_Received(item, utc_now()))

    def put_all(self, lines: Iterable[str]) -> None:
        """Take several lines of the log."""
        for line in lines:
            self._waiting.put(_Received(line, utc_now()))

    def close(self, timeout_s: float, called_off: Callable[[], bool] = lambda: False) -> bool:
        """Wait until all is stored, at most `timeout_s` or until called off; returns whether all is stored.

        Raises what `check` raises.
        """
        self._waiting.put(None)
        deadline = time.monotonic() + timeout_s
        while self._thread.is_alive() and time.monotonic() < deadline and not called_off():
            self._thread.join(min(_POLL_S, timeout_s))
        self.check()
        return not self._thread.is_alive()

    def abandon(self) -> None:
        """Wait no longer for an unavailable store: what is not stored yet is lost."""
        self._is_abandoned = True
        self._waiting.put(None)

    def check(self) -> None:
        """Raises what stopped the storing early: LeaseLost, if the attempt's job is no longer ours."""
        if self._failure is not None:
            raise self._failure

    def _work(self) -> None:
        while True:
            items = self._take()
            heard = [item for item in items if item is not None]
            for step in self._steps(heard):
                if not self._insist(step):
                    return
            if None in items:
                return

    def _take(self) -> list[_Received | None]:
        """At least one item, and all others that wait already, so that a flood takes few writes."""
        items = [self._waiting.get()]
        with contextlib.suppress(queue.Empty):
            while len(items) < 500:
                items.append(self._waiting.get_nowait())
        return items

    def _steps(self, heard: Sequence[_Received]) -> Iterator[Callable[[], None]]:
        """The writes that store these: one for all lines, one for every 100 messages between two files."""
        lines = [item for item in heard if isinstance(item.what, str)]
        if lines:
            yield partial(self._store_lines, lines, _new_id())
        messages = [item for item in heard if not isinstance(item.what, str)]
        for is_said, group in groupby(messages, lambda item: isinstance(item.what, _FEED_MESSAGES)):
            found = list(group)
            size = _MAX_FEED_MESSAGES if is_said else 1
            for first in range(0, len(found), size):
                part = found[first : first + size]
                yield partial(self._store_said if is_said else self._store_one, part, _new_id())

    def _insist(self, step: Callable[[], None]) -> bool:
        """Do it, through any outage; returns whether it succeeded."""
        try:
            retry_while_unavailable(step, called_off=lambda: self._is_abandoned)
        except Exception as error:  # Whatever it is, the job must not seem done.
            self._failure = error
            return False
        return True

    def _store_lines(self, lines: Sequence[_Received], write_id: str) -> None:
        self._record(
            "logs", [Entry(kind="line", time=item.time, data={"text": item.what}) for item in lines], write_id
        )

    def _store_said(self, messages: Sequence[_Received], write_id: str) -> None:
        entries, progress, newest = list[Entry](), self._progress, dict(self._newest)
        for item in messages:
            if isinstance(item.what, Measured):
                newest = _with_newest(newest, item.what)
            progress = _advanced(progress, item.what, newest)
            entries.append(_entry(item, progress))
        self._record("events", entries, write_id, None if progress is self._progress else progress)
        self._progress, self._newest = progress, newest

    def _store_one(self, heard: Sequence[_Received], write_id: str) -> None:
        (item,) = heard
        match item.what:
            case Started(device=device, engine=engine, details=details):
                self._claim.start(device=device, engine=engine, details=details)
            case MemoryPeak(bytes=num_bytes):
                self._claim.note_peak(num_bytes)
            case FileReady() as message:
                self._publish(message, item.time, write_id)
            case Failed() | Finished():  # The supervisor judges these.
                pass
            case _:
                raise TypeError(f"{item.what!r} is not stored on its own")

    def _record(
        self, channel: Channel, entries: Sequence[Entry], write_id: str, progress: Progress | None = None
    ) -> None:
        self._claim.store.record(
            self._claim.job_id, self._claim.token, channel, entries, progress, write_id=write_id
        )

    def _publish(self, message: FileReady, heard_at: datetime, write_id: str) -> None:
        began = time.monotonic()
        try:
            with open_plain(self._spool, message.path) as file:
                artifact = self._upload(message, file)
        except NotPlain as error:  # Only a process that was taken over names one.
            log.warning("file_not_kept", job_id=self._claim.job_id, name=message.name, error=str(error))
            data = {"text": f"The training's file {message.name[:100]} was not kept: it is no plain file."}
            self._record("events", [Entry(kind="note", time=heard_at, data=data)], write_id)
            return
        seconds = time.monotonic() - began
        self._tallies.add(UPLOADS, 1)
        self._tallies.add(UPLOADED_BYTES, artifact.size)
        _, dropped = self._claim.publish((artifact,), self._keep_checkpoints)
        data = {
            "name": message.name,
            "role": message.role,
            "step": message.step,
            "upload_s": round(seconds, 4),
        }
        if message.role == "best_policy":
            data["return"] = message.metadata.get("return")
        self._record("events", [Entry(kind="artifact", time=heard_at, data=data)], write_id)
        (self._spool / message.path).unlink(missing_ok=True)
        self._remove_later(dropped)

    def _remove_later(self, dropped: Sequence[str]) -> None:
        """Remove what was dropped some time ago, and remember what is dropped now.

        The collection of orphans removes those that are left when the attempt ends, or cannot be removed.
        """
        now = time.monotonic()
        due = [key for at, key in self._dropped if now - at > _DELETE_AFTER_S]
        self._dropped = [(at, key) for at, key in self._dropped if now - at <= _DELETE_AFTER_S]
        self._dropped += [(now, key) for key in dropped]
        with contextlib.suppress(StorageUnavailable):
            for key in due:
                self._claim.objects.delete_prefix(key)

    def _upload(self, message: FileReady, file: BufferedReader) -> Artifact:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        size = file.seek(0, os.SEEK_END)
        artifact = Artifact(
            **message.model_dump(exclude={"type", "path"}),
            size=size,
            sha256=digest,
            key=self._key(digest, message.name),
        )
        file.seek(0)
        self._claim.objects.put_stream(artifact.key, file, size, media_type=artifact.media_type)
        return artifact

    def _key(self, sha256: str, name: str) -> str:
        return keys.artifact(self._claim.job_id, self._claim.number, sha256, name)


def _with_newest(newest: Mapping[str, float], row: Measured) -> dict[str, float]:
    """The newest values that a job shows, with this row. A value of one of several seeds is not shown."""
    shown = {name: value for name, value in newest.items() if name not in row.values}
    return shown | {name: value for name, value in row.finite.items() if not is_of_a_seed(name)}


def _advanced(progress: Progress, message: Message | str, newest: dict[str, float]) -> Progress:
    match message:
        case PhaseBegan(phase=phase):
            return progress.model_copy(update={"phase": phase})
        case Advanced():
            return Progress(**message.model_dump(exclude={"type"}), metrics=newest, phase=progress.phase)
        case Measured():  # What a battery finds comes after the last step.
            return progress.model_copy(update={"metrics": newest})
        case _:
            return progress


def _entry(item: _Received, progress: Progress) -> Entry:
    """progress: with this message."""
    match item.what:
        case Hello(pid=pid):
            return Entry(kind="phase", time=item.time, data={"name": "process", "pid": pid})
        case Noted(text=text):
            return Entry(kind="note", time=item.time, data={"text": text})
        case PhaseBegan() | Advanced():
            return Entry(kind="progress", time=item.time, data=progress.model_dump(exclude={"metrics"}))
        case PhaseEnded() as message:
            return Entry(kind="phase", time=item.time, data=message.model_dump(exclude={"type"}))
        case Measured(step=step) as message:
            return Entry(kind="metrics", time=item.time, data={"step": step, "values": message.finite})
        case _:
            raise TypeError(f"{item.what!r} is no entry")


def _new_id() -> str:
    """The identity of a write; a retry keeps it."""
    return secrets.token_hex(8)
