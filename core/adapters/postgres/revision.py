"""Whether the tables are of this version, without Alembic, which takes a tenth of a second to load."""

from pathlib import Path

from sqlalchemy import Engine, text

from core.adapters.postgres.errors import Breaker

_MIGRATIONS = Path(__file__).parent / "migrations" / "versions"


def newest() -> str:
    """The revision that the last migration makes; the migration's file name begins with it."""
    return max(file.name.partition("_")[0] for file in _MIGRATIONS.glob("[0-9]*.py"))


def is_newest(engine: Engine) -> bool:
    """Whether the tables exist and need no migration. Raises RecordsUnavailable, RecordsRefuse."""
    with Breaker().reaching(), engine.connect() as connection:
        if connection.execute(text("SELECT to_regclass('alembic_version')")).scalar_one() is None:
            return False
        found = connection.execute(text("SELECT version_num FROM alembic_version")).scalars().all()
    return found == [newest()]
