"""The connections that all parts of the record in PostgreSQL share."""

from collections.abc import Generator
from contextlib import contextmanager

from sqlalchemy import Connection, Engine

from core.adapters.postgres.errors import Breaker


class Connected:
    """Its methods reach the database through these two. The engine comes from `connect_postgres`."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._autocommit = engine.execution_options(isolation_level="AUTOCOMMIT")
        self._breaker = Breaker()

    @contextmanager
    def _transaction(self, *, is_large: bool = False) -> Generator[Connection]:
        """is_large: its statements may be slow because of their size, which says nothing to other calls."""
        with (
            self._breaker.reaching(is_large=is_large),
            self._engine.connect() as connection,
            connection.begin(),
        ):
            yield connection

    @contextmanager
    def _statements(self) -> Generator[Connection]:
        """Each statement is its own transaction, which saves the round trips of BEGIN and COMMIT."""
        with self._breaker.reaching(), self._autocommit.connect() as connection:
            yield connection
