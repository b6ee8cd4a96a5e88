"""A compiler for runs of many updates."""

import pytest

from core.algorithms import compiled_functions


@pytest.fixture
def compiled_for_longer_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where LLVM optimises nothing, SAC's hundreds of updates take longer than it takes to optimise them."""
    monkeypatch.setattr(compiled_functions, "compiler_options", lambda: {"xla_backend_optimization_level": 1})
