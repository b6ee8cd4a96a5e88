"""Creates the database's tables, upgrades them, or takes them back to an earlier version."""

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import structlog
from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, text

from core.adapters.postgres.connection import DEADLINE_S, PromptConnection
from core.adapters.postgres.errors import Breaker
from core.errors import Misconfigured

log = structlog.get_logger()

# An arbitrary number of ours: two processes that migrate wait for each other.
_LOCK = 0x6761697477617921


def upgrade(engine: Engine, revision: str = "head") -> None:
    """Bring the tables to this revision; does nothing if they already are.

    Raises RecordsUnavailable, RecordsRefuse; Misconfigured for tables that this version cannot upgrade.
    """
    with _alone(engine) as (connection, config):
        now, newest = current(connection), _script(config).get_current_head()
        if now is not None and not _is_known(config, now):
            if now < str(newest):
                raise Misconfigured(
                    f"A version before the first release made the tables of GAITWAY_DATABASE_URL (revision "
                    f"{now}; this one knows {newest}), and cannot be upgraded: name an empty database."
                )
            raise Misconfigured(
                f"A newer version of Gaitway made the tables of GAITWAY_DATABASE_URL (revision {now}; this "
                f"one knows {newest}): start that version, or downgrade the tables with it first."
            )
        if now != newest or revision != "head":
            command.upgrade(config, revision)
            log.info("database_upgraded", before=now, now=current(connection))


def downgrade(engine: Engine, revision: str) -> None:
    """Take the tables back to an earlier revision; `base` drops them all."""
    with _alone(engine) as (connection, config):
        now = current(connection)
        command.downgrade(config, revision)
        log.info("database_downgraded", before=now, now=current(connection))


def current(connection: Connection) -> str | None:
    """The revision of the tables; None if there are none."""
    return MigrationContext.configure(connection).get_current_revision()


@dataclass(frozen=True)
class Facts:
    """A database as the doctor reports it. server: its version; newest: the revision that we make."""

    server: str
    revision: str | None
    newest: str | None
    is_known: bool
    is_durable: bool


def facts(engine: Engine) -> Facts:
    """Raises RecordsUnavailable, RecordsRefuse."""
    with Breaker().reaching(), engine.connect() as connection:
        names = ("server_version", "fsync", "full_page_writes", "synchronous_commit")
        said = [connection.execute(text(f"SHOW {name}")).scalar_one() for name in names]
        revision, config = current(connection), _config()
    return Facts(
        server=said[0].split()[0],
        revision=revision,
        newest=_script(config).get_current_head(),
        is_known=revision is None or _is_known(config, revision),
        is_durable="off" not in said[1:],
    )


@contextmanager
def _alone(engine: Engine) -> Generator[tuple[Connection, Config]]:
    """A connection in a transaction that no other migration shares, without the usual time limits."""
    with Breaker().reaching(), engine.connect() as connection, _patient(connection), connection.begin():
        connection.execute(text("SET LOCAL lock_timeout = '60s'"))
        connection.execute(text("SET LOCAL statement_timeout = 0"))
        connection.execute(text(f"SELECT pg_advisory_xact_lock({_LOCK})"))
        config = _config()
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


def _config() -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    return config


def _script(config: Config) -> ScriptDirectory:
    return ScriptDirectory.from_config(config)


def _is_known(config: Config, revision: str) -> bool:
    return any(script.revision == revision for script in _script(config).walk_revisions())
