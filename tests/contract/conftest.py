"""The record's tables; and Warp's compiled kernels, kept for all processes of one test run.

Compiling those takes most of a minute.
"""

import os
from collections.abc import Iterator
from pathlib import Path

import psycopg
import pytest

from core.physics.warp_cache import set_warp_cache
from tests.contract.recording import Database


@pytest.fixture
def database(database_url: str) -> Iterator[Database]:
    """The tables of the record that this test has."""
    with psycopg.connect(database_url, autocommit=True) as connection:
        yield Database(connection)


@pytest.fixture(scope="session")
def warp_kernels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    import warp

    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # each process of xdist has a folder of its own in there
    set_warp_cache(folder / "warp")
    if not warp.is_cuda_available():  # CUDA 13's compiler is unsafe so, and Warp warns of it.
        warp.config.optimization_level = 0  # Halves the time that compiling takes.
    return folder / "warp"
