"""The role under which workers on other machines reach PostgreSQL: it sees jobs, and no accounts."""

from typing import Any, LiteralString, cast

import psycopg
import structlog
from psycopg import sql
from psycopg.conninfo import conninfo_to_dict
from sqlalchemy import Engine

from core.adapters.postgres.errors import Breaker
from core.errors import Misconfigured

log = structlog.get_logger()

_SETTING = "GAITWAY_WORKER_DATABASE_URL"
_ALL = "SELECT, INSERT, UPDATE, DELETE"
RIGHTS = {
    "jobs": "SELECT, UPDATE",
    "attempts": "SELECT, INSERT, UPDATE",
    "artifacts": _ALL,
    "chunks": "SELECT",
    "entries": "SELECT, INSERT",
    "metrics": "SELECT, INSERT, UPDATE",
    "dispatches": _ALL,
    "models": "SELECT, UPDATE",
    "clip_files": "SELECT, UPDATE",
    "workers": _ALL,
    "pulse": "SELECT",
    "news": "INSERT",
    "usage": "SELECT, INSERT, UPDATE",
    "peaks": _ALL,
    "shares": "SELECT, INSERT, UPDATE",
    "quotas": "SELECT",
}


def prepare_worker_role(engine: Engine, url: str) -> None:
    """Let the user of this address do what a worker does, and nothing else; it is made if it is missing.

    Raises Misconfigured where the address has no user of its own, or the service may not make one.
    """
    parts = conninfo_to_dict(url)
    role, password = parts.get("user"), parts.get("password")
    with Breaker().reaching(), engine.connect() as connection, connection.begin():
        driver = cast("psycopg.Connection[Any]", connection.connection.driver_connection)
        own = connection.exec_driver_sql("SELECT current_user").scalar_one()
        if not role or not password or role == own:
            raise Misconfigured(
                f"{_SETTING} needs a user of its own, and a password: {own} may do everything."
            )
        name = sql.Identifier(str(role))
        is_there = driver.execute("SELECT 1 FROM pg_roles WHERE rolname = %s", [role]).fetchone() is not None
        if not is_there:
            _make(driver, name, str(password))
        everything = sql.SQL("REVOKE ALL ON ALL TABLES IN SCHEMA public FROM {}")
        driver.execute(everything.format(name))
        for table, rights in RIGHTS.items():
            grant = sql.SQL("GRANT {} ON {} TO {}")
            driver.execute(grant.format(sql.SQL(cast("LiteralString", rights)), sql.Identifier(table), name))
        if _may_more(driver, str(role)):
            raise Misconfigured(
                f"The user {role} of {_SETTING} has rights of its own, by which workers would read users and "
                "tokens: as an administrator of PostgreSQL, take them away, or name another user."
            )
    log.info("worker_role_prepared", role=role, made=not is_there)


def _may_more(driver: "psycopg.Connection[Any]", role: str) -> bool:
    """Whether the role reaches other tables: as superuser, through a role that it is in, or by making one."""
    rest = driver.execute(
        """
        SELECT rolcreaterole OR pg_has_role(oid, current_user, 'MEMBER')
          OR EXISTS (
            SELECT FROM pg_class
            WHERE relnamespace = 'public'::regnamespace AND relkind = 'r' AND relname <> ALL (%s)
              AND has_table_privilege(pg_roles.oid, pg_class.oid, 'SELECT, INSERT, UPDATE, DELETE')
          )
        FROM pg_roles WHERE rolname = %s
        """,
        [[*RIGHTS], role],
    )
    return bool(rest.fetchone() == (True,))


def _make(driver: "psycopg.Connection[Any]", name: sql.Identifier, password: str) -> None:
    try:
        driver.execute(sql.SQL("CREATE ROLE {} LOGIN PASSWORD {}").format(name, sql.Literal(password)))
    except psycopg.errors.InsufficientPrivilege:
        raise Misconfigured(
            f"The user of {_SETTING} does not exist, and that of GAITWAY_DATABASE_URL may not make it: as an "
            "administrator of PostgreSQL, CREATE ROLE … LOGIN PASSWORD '…' with what that address says."
        ) from None
