"""Creates the database's tables, upgrades them, or takes them back to an earlier version.

Alembic is imported where it migrates: it takes a tenth of a second to load, and is needed once per version.
"""

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

import structlog
from sqlalchemy import Connection, Engine, text

from core.adapters.postgres.engine import DEADLINE_S, PromptConnection
from core.adapters.postgres.errors import Breaker
from core.errors import Misconfigured

if TYPE_CHECKING:
    from alembic.config import Config

log = structlog.get_logger()

# An arbitrary number of ours: two processes that migrate wait for each other.
_LOCK = 0x6761697477617921
_MIGRATIONS = Path(__file__).parent / "migrations"


def known() -> list[str]:
    """The revisions of this version, oldest first; a migration's file name begins with its own."""
    return sorted(file.name.partition("_")[0] for file in (_MIGRATIONS / "versions").glob("[0-9]*.py"))


def upgrade(engine: Engine, revision: str = "head") -> None:
    """Bring the tables to this revision; does nothing if they already are.

    Raises RecordsUnavailable, RecordsRefuse; Misconfigured for tables that this version cannot upgrade.
    """
    newest = known()[-1]
    if revision == "head":
        with Breaker().reaching(), engine.connect() as connection:
            if current(connection) == newest:
                return
    from alembic import command

    with _alone(engine) as (connection, config):
        now = current(connection)
        if now is not None and now not in known():
            raise Misconfigured(_refusal(now, newest))
        if now != newest or revision != "head":
            command.upgrade(config, revision)
            log.info("database_upgraded", before=now, now=current(connection))


def _refusal(now: str, newest: str) -> str:
    tables = f"made the tables of GAITWAY_DATABASE_URL (revision {now}; this one knows {newest})"
    if now < newest:
        return f"A version before the first release {tables} and has no upgrade: name an empty database."
    return f"A newer version of Gaitway {tables}: start that version, or downgrade the tables with it first."


def downgrade(engine: Engine, revision: str) -> None:
    """Take the tables back to an earlier revision; `base` drops them all."""
    from alembic import command

    with _alone(engine) as (connection, config):
        now = current(connection)
        command.downgrade(config, revision)
        log.info("database_downgraded", before=now, now=current(connection))


def current(connection: Connection) -> str | None:
    """The revision of the tables; None if there are none."""
    if connection.execute(text("SELECT to_regclass('alembic_version')")).scalar_one() is None:
        return None
    return connection.execute(text("SELECT version_num FROM alembic_version")).scalar()


@dataclass(frozen=True)
class Facts:
    """A database as the doctor reports it. server: its version; newest: the revision that we make."""

    server: str
    revision: str | None
    newest: str
    is_known: bool
    is_durable: bool


def facts(engine: Engine) -> Facts:
    """Raises RecordsUnavailable, RecordsRefuse."""
    with Breaker().reaching(), engine.connect() as connection:
        names = ("server_version", "fsync", "full_page_writes", "synchronous_commit")
        settings = [connection.execute(text(f"SHOW {name}")).scalar_one() for name in names]
        revision = current(connection)
    return Facts(
        server=settings[0].split()[0],
        revision=revision,
        newest=known()[-1],
        is_known=revision is None or revision in known(),
        is_durable="off" not in settings[1:],
    )


@contextmanager
def _alone(engine: Engine) -> Generator[tuple[Connection, "Config"]]:
    """A connection in a transaction that no other migration shares, without the usual time limits."""
    from alembic.config import Config

    with Breaker().reaching(), engine.connect() as connection, _patient(connection), connection.begin():
        connection.execute(text("SET LOCAL lock_timeout = '60s'"))
        connection.execute(text("SET LOCAL statement_timeout = 0"))
        connection.execute(text(f"SELECT pg_advisory_xact_lock({_LOCK})"))
        config = Config()
        config.set_main_option("script_location", str(_MIGRATIONS))
        config.attributes["connection"] = connection
        yield connection, config


@contextmanager
def _patient(connection: Connection) -> Generator[None]:
    """Let the server take as long as it needs: changing a large table takes minutes."""
    driver = cast("PromptConnection", connection.connection.driver_connection)
    driver.deadline_s = None
    try:
        yield
    finally:
        driver.deadline_s = DEADLINE_S
