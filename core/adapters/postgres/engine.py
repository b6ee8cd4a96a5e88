"""Connections to PostgreSQL; every call ends within seconds, even if the server is silent."""

import select
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from datetime import datetime, timedelta
from typing import Any

import psycopg
from psycopg import errors
from psycopg.conninfo import conninfo_to_dict
from psycopg.rows import dict_row
from sqlalchemy import URL, ClauseElement, Connection, Engine, create_engine, event
from sqlalchemy.dialects.postgresql.psycopg import PGDialect_psycopg
from sqlalchemy.exc import InvalidatePoolError
from sqlalchemy.pool import ConnectionPoolEntry, NullPool, QueuePool

from core.adapters.postgres.errors import Breaker, NoAnswer
from core.adapters.timing import Observe, timed, unobserved
from core.errors import Misconfigured

# If a call takes longer, the server is stopped, cut off or overloaded.
DEADLINE_S = 2.0
# An answer about the time that took longer is too old to extrapolate from.
_PROMPT_S = 0.05
# The server gives up before that: its error says more than silence.
_OPTIONS = " ".join(
    (
        "-c statement_timeout=1800",
        "-c lock_timeout=1500",
        # Frees the locks of a client that was stopped in the middle of a transaction.
        "-c idle_in_transaction_session_timeout=5000",
        "-c timezone=UTC",
        "-c application_name=gaitway",
    )
)


class PromptConnection(psycopg.Connection[Any]):
    """A connection that gives up on a server after `deadline_s` of silence; None: never."""

    deadline_s: float | None = DEADLINE_S

    def wait(self, gen: Any, interval: float = 0.1, timeout: float | None = None) -> Any:
        try:
            return super().wait(gen, interval, self.deadline_s if timeout is None else timeout)
        except errors._WaitTimeout as error:  # pyright: ignore[reportPrivateUsage]
            self.pgconn.finish()  # It cannot be used again: nobody knows how far the call got.
            raise NoAnswer(f"no answer within {self.deadline_s:g} s") from error


class _Pool(QueuePool):
    """It also closes what comes back after `dispose`: a thread may still have been in a call."""

    _is_disposed = False

    def dispose(self) -> None:
        self._is_disposed = True
        super().dispose()

    def _do_return_conn(self, record: ConnectionPoolEntry) -> None:
        super()._do_return_conn(record)
        if self._is_disposed:
            super().dispose()


def connect_postgres(url: str, *, pool_size: int = 10) -> Engine:
    """An engine for a postgresql:// address; it connects at its first call.

    pool_size: connections kept and reused; 0 opens one for each call, for a process that forks.
    Raises Misconfigured for an address that cannot be read.
    """
    if not _is_readable(url):
        raise Misconfigured(
            "GAITWAY_DATABASE_URL cannot be read: write postgresql://USER:PASSWORD@HOST:PORT/DATABASE, with "
            "characters such as / # @ in the password percent-encoded."
        )

    def connect() -> psycopg.Connection[Any]:
        # In a database without an encoding (SQL_ASCII), text would come back as bytes otherwise.
        return PromptConnection.connect(url, connect_timeout=2, options=_OPTIONS, client_encoding="UTF8")

    # In each new process, to read an address as text would take milliseconds, and to ask for hstore a trip.
    driver, options = URL.create("postgresql+psycopg"), {"creator": connect, "use_native_hstore": False}
    if pool_size == 0:
        return create_engine(driver, **options, poolclass=NullPool)
    engine = create_engine(
        driver,
        **options,
        poolclass=_Pool,
        pool_size=pool_size,
        max_overflow=2 * pool_size,
        pool_timeout=DEADLINE_S,
    )
    event.listen(engine, "checkout", _refuse_closed)
    return engine


def _is_readable(url: str) -> bool:
    """Whether host, port and database can be what they say.

    After an unencoded character in the password, the rest of it is read as host, port or database, which
    error messages show.
    """
    try:
        parts = conninfo_to_dict(url)
    except psycopg.ProgrammingError:
        return False
    ports = [port for port in str(parts.get("port") or "").split(",") if port]
    has_ports = all(port.isascii() and port.isdigit() and 0 < int(port) < 2**16 for port in ports)
    return has_ports and not any("@" in str(parts.get(name)) for name in ("host", "dbname"))


def _refuse_closed(connection: PromptConnection, record: ConnectionPoolEntry, _: object) -> None:
    """Discard a connection that the server has closed, for example by a restart.

    The socket of a closed connection is readable, which is seen without a round trip; an open one has nothing
    to read between two statements.
    """
    is_new, record.info["was_used"] = "was_used" not in record.info, True
    poll = select.poll()  # Unlike `select`, it takes descriptors beyond 1023.
    poll.register(connection.fileno(), select.POLLIN)
    if not is_new and poll.poll(0):
        raise InvalidatePoolError


class DriverStatement:
    """A statement that is compiled where it is made, and that the driver runs without SQLAlchemy.

    For what a process does once, as it claims a job and ends it: to compile its statements took most of the
    time.
    """

    # Parameters are numbered, as PostgreSQL has them, so that the driver does not look for them.
    _DIALECT = PGDialect_psycopg(paramstyle="numeric_dollar")

    def __init__(self, statement: ClauseElement, settings: str | None = None) -> None:
        """settings: a statement that goes before it, in the same round trip and the same transaction."""
        compiled: Any = statement.compile(dialect=self._DIALECT, compile_kwargs={"render_postcompile": True})
        self._text: Any = str(compiled)
        self._constants, self._order = compiled.params, compiled.positiontup
        self._settings = settings

    def rows(self, connection: Connection, values: Mapping[str, Any]) -> list[dict[str, Any]]:
        """The rows that it returns. values: of its parameters, by name; it ignores other names."""
        driver: Any = connection.connection.driver_connection
        given = {**self._constants, **values}
        ordered = [given[name] for name in self._order]
        try:
            with psycopg.RawCursor(driver, row_factory=dict_row) as cursor:
                if self._settings is None:
                    connection.dialect.do_execute(cursor, self._text, ordered)  # pyright: ignore
                    return cursor.fetchall()
                with driver.pipeline():  # Here it takes no round trip to prepare it.
                    driver.execute(self._settings)
                    return cursor.execute(self._text, ordered, prepare=True).fetchall()
        except psycopg.Error as error:
            if driver.closed:
                connection.invalidate(error)  # As SQLAlchemy does after a statement of its own.
            raise


class Session:
    """Reaches the database for the classes with statements. The engine comes from `connect_postgres`."""

    def __init__(self, engine: Engine, observe: Observe = unobserved, breaker: Breaker | None = None) -> None:
        """breaker: of another session with the same engine, of whose failures this one then knows."""
        self._engine = engine
        self._observe = observe
        self._autocommit = engine.execution_options(isolation_level="AUTOCOMMIT")
        self._breaker = breaker or Breaker()

    @contextmanager
    def _transaction(self, *, is_large: bool = False) -> Generator[Connection]:
        """is_large: its statements may be slow because of their size, which says nothing to other calls."""
        with (
            timed(unobserved if is_large else self._observe, "postgresql"),
            self._breaker.reaching(is_large=is_large),
            self._engine.connect() as connection,
            connection.begin(),
        ):
            yield connection

    @contextmanager
    def _statements(self) -> Generator[Connection]:
        """Each statement is its own transaction, which saves the round trips of BEGIN and COMMIT."""
        with (
            timed(self._observe, "postgresql"),
            self._breaker.reaching(),
            self._autocommit.connect() as connection,
        ):
            yield connection

    def close(self) -> None:
        """Give the connections back."""
        self._engine.dispose()


class Clock:
    """Asks the database now and then, and extrapolates from its answer; thread-safe.

    ask: returns the database's time. max_age: how long an answer is used; a step of the database's clock is
    noticed after that time at the latest.
    """

    def __init__(self, ask: Callable[[], datetime], max_age: timedelta) -> None:
        self._ask = ask
        self._max_age = max_age
        # The answer and when it came, replaced together.
        self._answer: tuple[datetime, float] | None = None

    def now(self) -> datetime:
        """Raises what `ask` raises."""
        answer = self._answer
        if answer is not None and (passed := timedelta(seconds=time.monotonic() - answer[1])) < self._max_age:
            return answer[0] + passed
        asked_at = time.monotonic()
        said = self._ask()
        answered_at = time.monotonic()
        self._answer = (said, answered_at) if answered_at - asked_at < _PROMPT_S else None
        return said
