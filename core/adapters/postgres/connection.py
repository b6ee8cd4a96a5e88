"""Connections to PostgreSQL; every call ends within seconds, even if the server is silent."""

import select
from typing import Any

import psycopg
from psycopg import errors
from psycopg.conninfo import conninfo_to_dict
from sqlalchemy import Engine, create_engine, event
from sqlalchemy.exc import InvalidatePoolError
from sqlalchemy.pool import ConnectionPoolEntry, NullPool, QueuePool

from core.errors import Misconfigured

# If a call takes longer, the server is stopped, cut off or overloaded.
DEADLINE_S = 2.0
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


class NoAnswer(psycopg.OperationalError):
    """The server accepts connections and does not answer."""


class PromptConnection(psycopg.Connection[Any]):
    """A connection that gives up on a server after `deadline_s` of silence; None: never."""

    deadline_s: float | None = DEADLINE_S

    def wait(self, gen: Any, interval: float = 0.1, timeout: float | None = None) -> Any:
        try:
            return super().wait(gen, interval, self.deadline_s if timeout is None else timeout)
        except errors._WaitTimeout as error:  # pyright: ignore[reportPrivateUsage]
            self.pgconn.finish()  # It cannot be used again: nobody knows how far the call got.
            raise NoAnswer(f"no answer within {self.deadline_s:g} s") from error


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

    if pool_size == 0:
        return create_engine("postgresql+psycopg://", creator=connect, poolclass=NullPool)
    engine = create_engine(
        "postgresql+psycopg://",
        creator=connect,
        poolclass=QueuePool,
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
