"""The training process' end of the pipe and of the spool."""

import os
from pathlib import Path
from typing import Any

from core.jobs.job import ArtifactRole
from worker.protocol import FileReady, Message


class EventWriter:
    """Sends messages and whole files to the supervisor."""

    def __init__(self, spool: Path, events_fd: int) -> None:
        self.spool = spool
        self._pipe = os.fdopen(events_fd, "wb", buffering=0)

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
        """Write a file and hand it over; the supervisor sees it whole or not at all."""
        partial = self.spool / f".{name}"
        partial.write_bytes(content)
        partial.rename(self.spool / name)
        self.hand_over(name, role, media_type, step=step, metadata=metadata)

    def hand_over(
        self,
        name: str,
        role: ArtifactRole,
        media_type: str,
        *,
        step: int | None = None,
        metadata: dict[str, Any] | None = None,
    ) -> None:
        """Announce a whole file of this name in the spool."""
        self.send(
            FileReady(
                name=name, path=name, role=role, media_type=media_type, step=step, metadata=metadata or {}
            )
        )
