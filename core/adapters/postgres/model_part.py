"""The part of the record for users' own models."""

from collections.abc import Sequence

from core.adapters.cursors import check_model_cursor, model_cursor
from core.adapters.postgres import dispatch, models
from core.adapters.postgres.connected import Connected
from core.jobs.store import Dispatch
from core.user_models.record import ModelRecord
from core.user_models.store import ModelPage


class PostgresModels(Connected):
    """A ModelStore."""

    def find_model(self, model_id: str) -> ModelRecord:
        with self._statements() as connection:
            return models.find(connection, model_id)

    def add_model(self, record: ModelRecord) -> None:
        with self._transaction() as connection:
            models.add(connection, record)

    def model_dispatched(self, model_id: str) -> None:
        with self._statements() as connection:
            dispatch.remove(connection, [Dispatch("model", model_id)])

    def name_model(self, model_id: str, name: str) -> None:
        with self._statements() as connection:
            models.rename(connection, model_id, name)

    def settle_model(self, record: ModelRecord) -> None:
        with self._transaction() as connection:
            models.settle(connection, record)

    def delete_model(self, model_id: str) -> None:
        with self._transaction() as connection:
            models.forget(connection, model_id)

    def num_waiting_models(self) -> int:
        with self._statements() as connection:
            return len(models.waiting(connection))

    def models(self) -> Sequence[ModelRecord]:
        with self._statements() as connection:
            return models.every(connection)

    def list_models(
        self, *, cursor: str | None = None, limit: int = 50, name: str | None = None
    ) -> ModelPage:
        before = None if cursor is None else check_model_cursor(cursor)
        with self._statements() as connection:
            found, has_more = models.newest(connection, before, limit, name)
        return ModelPage(found, model_cursor(found[-1]) if has_more else None)
