"""From an engine's name to the engine; each one's libraries are loaded only when it is built.

The kernels that Warp compiles are kept in a folder that a worker names.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import assert_never

import mujoco

from core.physics.availability import EngineChoice, EngineName, check_installed, choose
from core.physics.coverage import check_runs
from core.physics.engine import DERIVED_FIELDS, Engine, EngineBuilder, SolverSettings
from core.physics.model import (
    with_asked_solver,
    with_enough_iterations,
    with_solver,
    with_solver_of_compiled,
)

__all__ = ["EngineChoice", "choose", "engine_builder"]


@dataclass(frozen=True)
class _Builder:
    """See EngineBuilder."""

    name: EngineName

    def __call__(
        self,
        model: mujoco.MjModel,
        num_substeps: int,
        derived: tuple[str, ...],
        *,
        accelerated: SolverSettings | None = None,
    ) -> Engine:
        unknown = sorted(set(derived) - set(DERIVED_FIELDS))
        if unknown:
            raise ValueError(f"No engine computes {unknown}; the derived fields are {DERIVED_FIELDS}.")
        if self.name != "compiled":  # It looks itself: some models take half a second.
            check_runs(self.name, model, derived)
        match self.name:
            case "native":
                from core.physics.native import NativeEngine

                return NativeEngine(with_asked_solver(model, accelerated), num_substeps, derived)
            case "mjx":
                from core.physics.mjx import MjxEngine

                return MjxEngine(with_solver(model, accelerated), num_substeps, derived)
            case "warp":
                check_installed("warp")
                from core.physics.warp_engine import WarpEngine

                return WarpEngine(with_enough_iterations(model, accelerated), num_substeps, derived)
            case "compiled":
                check_installed("compiled")
                from core.physics.compiled import CompiledEngine, check_solver

                check_solver(accelerated)
                solved = with_solver_of_compiled(model, accelerated)
                return CompiledEngine(solved, num_substeps, derived, accelerated and accelerated.nconmax)
            case _:
                assert_never(self.name)


def engine_builder(name: EngineName) -> EngineBuilder:
    """The function that an environment calls to get its engine.

    Building raises JobFailed if the worker lacks the engine, or the engine cannot run the model.
    """
    return _Builder(name)


def set_warp_cache(folder: Path) -> None:
    """Keep the kernels that Warp compiles in this folder, unless WARP_CACHE_PATH names another.

    Call it before the first engine is built: Warp reads the setting once. Raises JobFailed without Warp.
    """
    check_installed("warp")
    import warp

    if "WARP_CACHE_PATH" not in os.environ:
        warp.config.kernel_cache_dir = str(folder)
