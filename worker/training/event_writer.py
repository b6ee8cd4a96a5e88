"""The training process' end of the pipe and of the spool."""

import os
from collections import Counter
from collections.abc import Sequence
from copy import copy
from pathlib import Path
from typing import Any, Self

from core.jobs.job import ArtifactRole
from worker.protocol import LONGEST_MESSAGE, Failed, FileReady, Measured, Message, Noted

# Files that all seeds of a job share.
_SHARED: tuple[ArtifactRole, ...] = ("scene", "simulation")
# A text that is too long is cut to this length, which shows what it is about.
_KEPT = 4000


class EventWriter:
    """Sends messages and whole files to the supervisor."""

    def __init__(self, spool: Path, events_fd: int) -> None:
        self.spool = spool
        self._pipe = os.fdopen(events_fd, "wb", buffering=0)
        self._times_kept = Counter[str]()
        self._seed: int | None = None

    def of_seed(self, seed: int) -> Self:
        """The same writer for the files of one of several seeds: their names get the suffix `-seed-<n>`, and
        their metadata the seed. Files that the seeds share are kept once."""
        own = copy(self)
        own._seed = seed
        return own

    def send(self, message: Message) -> None:
        """Send it as one line; one that the supervisor would not read in parts, or what stands for it."""
        line = message.model_dump_json().encode() + b"\n"
        if len(line) <= LONGEST_MESSAGE:
            self._write(line)
            return
        for part in _instead_of(message, len(line)):
            self.send(part)

    def _write(self, line: bytes) -> None:
        """All of it: a signal may end a write of more than the pipe has room for before its end."""
        left = memoryview(line)
        while left:
            left = left[self._pipe.write(left) or 0 :]

    def keep(
        self,
        name: str,
        content: bytes,
        role: ArtifactRole,
        media_type: str,
        *,
        step: int | None = None,
        metadata: dict[str, Any] | None = None,
    ) -> None:
        """Write a file and hand it over; the supervisor sees it whole or not at all.

        One of a name that was kept before replaces it in the job's record.
        """
        if self._seed is not None and role in _SHARED and self._times_kept[name]:
            return
        own = self._own_name(name, role)
        # Until the supervisor has stored the one before, that one needs its own path.
        self._times_kept[own] += 1
        path = own if self._times_kept[own] == 1 else f"{self._times_kept[own]}-{own}"
        partial = self.spool / f".{path}"
        partial.write_bytes(content)
        partial.rename(self.spool / path)
        self._announce(own, path, role, media_type, step, metadata)

    def hand_over(
        self,
        name: str,
        role: ArtifactRole,
        media_type: str,
        *,
        step: int | None = None,
        metadata: dict[str, Any] | None = None,
    ) -> None:
        """Announce a whole file that lies in the spool under its name."""
        own = self._own_name(name, role)
        if own != name:  # The next seed writes a file of the same name there.
            (self.spool / name).rename(self.spool / own)
        self._announce(own, own, role, media_type, step, metadata)

    def _own_name(self, name: str, role: ArtifactRole) -> str:
        if self._seed is None or role in _SHARED:
            return name
        stem, dot, ending = name.partition(".")
        return f"{stem}-seed-{self._seed}{dot}{ending}"

    def _announce(
        self,
        name: str,
        path: str,
        role: ArtifactRole,
        media_type: str,
        step: int | None,
        metadata: dict[str, Any] | None,
    ) -> None:
        facts = metadata or {}
        if self._seed is not None and role not in _SHARED:
            facts = {**facts, "seed": self._seed}
        self.send(
            FileReady(name=name, path=path, role=role, media_type=media_type, step=step, metadata=facts)
        )


def _instead_of(message: Message, num_bytes: int) -> Sequence[Message]:
    """Shorter messages for one of so many bytes. What ends a training, or says how far it is, must arrive."""
    match message:
        case Measured(values=values) if len(values) > 1:
            names, half = list(values), len(values) // 2
            parts = ({name: values[name] for name in some} for some in (names[:half], names[half:]))
            return [message.model_copy(update={"values": part}) for part in parts]
        case Failed(message=text):
            return [message.model_copy(update={"message": text[:_KEPT]})]
        case Noted(text=text):
            return [message.model_copy(update={"text": text[:_KEPT]})]
        case _:
            return [
                Noted(
                    text=f"A message ({message.type}) is left out: it has {num_bytes} bytes, and may have "
                    f"{LONGEST_MESSAGE}."
                )
            ]
