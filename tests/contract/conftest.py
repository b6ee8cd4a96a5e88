"""The record's tables; and Warp's kernels, whose compilation takes most of a minute."""

from collections.abc import Iterator
from pathlib import Path

import psycopg
import pytest

from core.physics.choose import set_warp_cache
from tests.contract.recording import Database
from tests.kept_programs import KEPT


@pytest.fixture
def database(database_url: str) -> Iterator[Database]:
    """The tables of the record that this test has."""
    with psycopg.connect(database_url, autocommit=True) as connection:
        yield Database(connection)


@pytest.fixture(scope="session")
def warp_kernels() -> Path:
    import warp

    set_warp_cache(KEPT / "warp")
    if not warp.is_cuda_available():  # CUDA 13's compiler is unsafe so, and Warp warns of it.
        warp.config.optimization_level = 0  # Halves the time that compiling takes.
    return KEPT / "warp"
