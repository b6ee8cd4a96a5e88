"""The training process' end of the pipe and of the spool."""

import os
from collections import Counter
from pathlib import Path
from typing import Any

from core.jobs.job import ArtifactRole
from worker.protocol import FileReady, Message


class EventWriter:
    """Sends messages and whole files to the supervisor."""

    def __init__(self, spool: Path, events_fd: int) -> None:
        self.spool = spool
        self._pipe = os.fdopen(events_fd, "wb", buffering=0)
        self._times_kept = Counter[str]()

    def send(self, message: Message) -> None:
        """One line, in one write."""
        self._pipe.write(message.model_dump_json().encode() + b"\n")

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
        # Until the supervisor has stored the one before, that one needs its own path.
        self._times_kept[name] += 1
        path = name if self._times_kept[name] == 1 else f"{self._times_kept[name]}-{name}"
        partial = self.spool / f".{path}"
        partial.write_bytes(content)
        partial.rename(self.spool / path)
        self.hand_over(name, role, media_type, step=step, metadata=metadata, path=path)

    def hand_over(
        self,
        name: str,
        role: ArtifactRole,
        media_type: str,
        *,
        step: int | None = None,
        metadata: dict[str, Any] | None = None,
        path: str | None = None,
    ) -> None:
        """Announce a whole file in the spool, where its name is `path` if that is given."""
        self.send(
            FileReady(
                name=name,
                path=path or name,
                role=role,
                media_type=media_type,
                step=step,
                metadata=metadata or {},
            )
        )
