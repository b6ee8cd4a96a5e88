"""A PostgreSQL for the tests of a module, which they may stop and silence."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import psycopg
import pytest

from gaitway.service.embedded.postgres import Postgres
from tests.contract.recording import Database
from tests.faults.outages import Outages


@pytest.fixture(scope="module")
def postgres(tmp_path_factory: pytest.TempPathFactory, postgres_data: Path) -> Iterator[Outages]:
    folder = tmp_path_factory.mktemp("own_postgres")
    shutil.copytree(postgres_data, folder / "data")
    with Postgres(folder, durable=False) as server:
        yield Outages(server)


@pytest.fixture
def database(database_url: str) -> Iterator[Database]:
    """The tables of the record that this test has."""
    with psycopg.connect(database_url, autocommit=True) as connection:
        yield Database(connection)
