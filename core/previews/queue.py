"""The interface of the queue that brings requests for stills to workers."""

from typing import Protocol

from core.previews.record import PreviewRequest


class PreviewQueue(Protocol):
    """At-least-once; every method raises RecordsUnavailable when the queue cannot be reached."""

    def enqueue_preview(self, request: PreviewRequest) -> None:
        """Let any worker render the stills, before all jobs. Doing so twice changes nothing."""
        ...

    def contains_preview(self, preview_id: str) -> bool:
        """Whether it waits, or a worker is rendering it."""
        ...

    def num_previews(self) -> int:
        """How many wait for a worker."""
        ...
