"""Warp's compiled kernels, kept for all processes of one test run: compiling them takes most of a minute."""

import os
from pathlib import Path

import pytest

from core.physics.kernels import keep_kernels


@pytest.fixture(scope="session")
def warp_kernels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    import warp

    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # each process of xdist has a folder of its own in there
    keep_kernels(folder / "warp")
    if not warp.is_cuda_available():  # CUDA 13's compiler is unsafe so, and Warp warns of it.
        warp.config.optimization_level = 0  # Halves the time that compiling takes.
    return folder / "warp"
