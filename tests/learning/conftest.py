"""Programs that differ only in arguments are compiled once for all tests of a process."""

from collections.abc import Iterator
from pathlib import Path

import jax
import pytest

from core.algorithms import compiled_functions


@pytest.fixture(autouse=True, scope="session")
def compiled_programs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = [getattr(jax.config, name) for name in names]
    folder = tmp_path_factory.mktemp("compiled")
    for name, value in zip(names, (str(folder), 0.0), strict=True):
        jax.config.update(name, value)
    yield folder
    for name, value in zip(names, before, strict=True):
        jax.config.update(name, value)


@pytest.fixture
def compiled_for_longer_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where LLVM optimises nothing, SAC's hundreds of updates take longer than it takes to optimise them."""
    monkeypatch.setattr(compiled_functions, "compiler_options", lambda: {"xla_backend_optimization_level": 1})
