"""A PostgreSQL for the tests of a module, which they may stop and silence."""

from collections.abc import Iterator

import pytest

from gaitway.embedded.postgres import Postgres
from tests.faults.outages import Outages


@pytest.fixture(scope="module")
def postgres(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Outages]:
    with Postgres(tmp_path_factory.mktemp("own_postgres"), durable=False) as server:
        yield Outages(server)
