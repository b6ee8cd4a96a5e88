"""The models of Brax's bodies, and how far each engine solves for them."""

from typing import Any

import mujoco

from core.physics.engine import SolverSettings
from core.physics.model import BRAX_SOLVER, brax_spec


def plain(body: str, options: Any) -> tuple[mujoco.MjSpec, SolverSettings | None]:
    """Brax's file; every engine keeps its solver's settings."""
    return brax_spec(body), None


def humanoid(body: str, options: Any) -> tuple[mujoco.MjSpec, SolverSettings | None]:
    """Brax's file, and its settings for MJX."""
    return brax_spec(body), BRAX_SOLVER


def ant(body: str, options: Any) -> tuple[mujoco.MjSpec, SolverSettings | None]:
    """Brax's ant with MuJoCo's own limit of 100 solver iterations. Its file allows 4, which was too few in
    1 of 200 steps of a running ant; it stumbled there. Most steps make 1 to 3."""
    spec = brax_spec(body)
    spec.option.iterations = 100
    return spec, BRAX_SOLVER
