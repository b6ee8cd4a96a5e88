"""The interface of the queue that brings models to workers for validation."""

from typing import Protocol


class ModelQueue(Protocol):
    """At-least-once; both methods raise RecordsUnavailable when the queue cannot be reached."""

    def enqueue_model(self, model_id: str) -> None:
        """Let any worker validate the model, after all jobs. Doing so twice changes nothing."""
        ...

    def contains_model(self, model_id: str) -> bool:
        """Whether it waits, or a worker is validating it."""
        ...
