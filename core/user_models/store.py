"""The seam to the records of users' own models."""

from collections.abc import Sequence
from typing import Protocol

from core.user_models.record import ModelRecord


class ModelStore(Protocol):
    """Part of the record. Every method raises RecordsUnavailable when the store cannot be reached."""

    def find_model(self, model_id: str) -> ModelRecord:
        """Raises ModelNotFound."""
        ...

    def add_model(self, record: ModelRecord) -> None:
        """Store the record in the place of an earlier one; one that waits for its validation is to be
        dispatched."""
        ...

    def model_dispatched(self, model_id: str) -> None:
        """The queue knows that the model waits for its validation."""
        ...

    def settle_model(self, record: ModelRecord) -> None:
        """Store what was found out. Raises ModelNotFound where the model was deleted meanwhile."""
        ...

    def delete_model(self, model_id: str) -> None:
        """Forget the record; not there is no error."""
        ...

    def num_waiting_models(self) -> int:
        """How many are to be looked at."""
        ...

    def models(self) -> Sequence[ModelRecord]:
        """All there are, by their ids."""
        ...
