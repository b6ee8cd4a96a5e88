"""The seam to whatever brings models to workers, to be looked at."""

from typing import Protocol


class ModelQueue(Protocol):
    """At-least-once; both methods raise RecordsUnavailable when the queue cannot be reached."""

    def enqueue_model(self, model_id: str) -> None:
        """Let any worker validate the model, behind all jobs. Twice is the same as once."""
        ...

    def contains_model(self, model_id: str) -> bool:
        """Whether it waits, or a worker is at it."""
        ...
