"""The end of a job that asks for what the stages cannot compute."""

from collections.abc import Sequence

import mujoco

from core.errors import JobFailed
from core.physics.availability import NEWTON_ALONE, beyond_compiled
from core.physics.engine import SolverSettings
from core.reasons import Reason
from mujoco_compiled.coverage import uncovered, uncovered_fields, uncovered_own


def check_solver(settings: SolverSettings | None) -> None:
    """Raises JobFailed("bad_model") if the job itself asks for a solver that the stages lack."""
    if settings is not None and "solver" in settings.asked and settings.solver != "newton":
        _refuse(NEWTON_ALONE)


def check_covered(model: mujoco.MjModel, derived: Sequence[str] = ()) -> None:
    """Raises JobFailed("bad_model") if the stages cannot move the model, or compute these fields of it."""
    _refuse(uncovered(model) or uncovered_fields(model, derived))


def check_own(model: mujoco.MjModel, names: Sequence[str], derived: Sequence[str] = ()) -> None:
    """Raises JobFailed("bad_model") if environments cannot have these fields of the model for themselves,
    where these derived fields are read."""
    _refuse(uncovered_own(model, names, derived))


def _refuse(reason: str | None) -> None:
    if reason is not None:
        raise JobFailed(Reason.BAD_MODEL, beyond_compiled(reason))
