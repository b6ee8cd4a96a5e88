"""The interface of the records of users' own models."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from core.user_models.record import ModelRecord


@dataclass(frozen=True)
class ModelPage:
    """Some models, newest first, and the cursor of the next page; None at the end."""

    models: Sequence[ModelRecord]
    next_cursor: str | None


class ModelStore(Protocol):
    """Part of the record. Every method raises RecordsUnavailable when the store cannot be reached."""

    def find_model(self, model_id: str) -> ModelRecord:
        """Raises ModelNotFound."""
        ...

    def add_model(self, record: ModelRecord) -> None:
        """Store the record, in place of an earlier one; one that waits for its validation gets a dispatch."""
        ...

    def model_dispatched(self, model_id: str) -> None:
        """Record that the queue has received the model."""
        ...

    def name_model(self, model_id: str, name: str) -> None:
        """Give it another name. Raises ModelNotFound."""
        ...

    def settle_model(self, record: ModelRecord) -> None:
        """Store the result of the validation; the name stays.

        Raises ModelNotFound where the model was deleted meanwhile.
        """
        ...

    def delete_model(self, model_id: str) -> None:
        """Forget the record; a missing one is no error."""
        ...

    def num_waiting_models(self) -> int:
        """How many wait for validation."""
        ...

    def models(self) -> Sequence[ModelRecord]:
        """All models, ordered by id."""
        ...

    def list_models(
        self, *, cursor: str | None = None, limit: int = 50, name: str | None = None
    ) -> ModelPage:
        """Some of them, the last sent first. cursor: the `next_cursor` of an earlier page. name: only those.

        Raises Rejected for any other.
        """
        ...
