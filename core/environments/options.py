"""Options that several environments share, and the types of their values."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from core.bounds import Real
from core.documents import Strict
from core.physics.availability import NEWTON_ALONE, EngineName, beyond_compiled


def _ascending(bounds: tuple[float, float | None]) -> tuple[float, float | None]:
    low, high = bounds
    if high is not None and low >= high:
        raise ValueError(f"[{low:g}, {high:g}] is not [low, high] with low < high")
    return bounds


def _not_descending(bounds: tuple[float, float]) -> tuple[float, float]:
    low, high = bounds
    if low > high:
        raise ValueError(f"[{low:g}, {high:g}] is not [low, high] with low ≤ high")
    return bounds


NotDescending = AfterValidator(_not_descending)
_FROM_A_LIST = Field(strict=False)  # JSON has no tuples

Range = Annotated[tuple[Real, Real], _FROM_A_LIST, AfterValidator(_ascending)]
"""[low, high], low < high."""

OpenRange = Annotated[tuple[Real, Real | None], _FROM_A_LIST, AfterValidator(_ascending)]
"""[low, high], low < high; `null` above means no bound."""

Weight = Annotated[float, Field(ge=-1e6, le=1e6)]
NoiseScale = Annotated[float, Field(ge=0, le=10)]


SolverIterations = int | None
SOLVER_ITERATIONS = "Solver iterations. null: 4 on mjx, warp and compiled; on native until it has converged."
LINE_SEARCH_ITERATIONS = "Line-search iterations. null: 8 on mjx, warp and compiled; on native 50 at most."


class RunnerOptions(Strict):
    """The reward and the physics of dm_control's walkers, on a floor (`rodent`) and in a `corridor`."""

    forward_reward_weight: Weight = Field(5.0, description="Reward for each metre per second in +x.")
    ctrl_cost_weight: Weight = Field(0.1, description="Cost of an action: this times its squared norm.")
    healthy_reward: Weight = Field(0.5, description="Reward for each step.")
    reset_noise_scale: NoiseScale = Field(1e-2, description="Noise on the initial positions and velocities.")
    n_frames: int = Field(5, ge=1, le=50, description="Physics steps per control step.")
    timestep: float = Field(0.002, ge=0.0005, le=0.005, description="Seconds per physics step.")
    solver: Literal["newton", "cg"] = Field(
        "newton", description="Constraint solver; compiled has Newton's alone."
    )
    iterations: SolverIterations = Field(None, ge=1, le=100, description=SOLVER_ITERATIONS)
    ls_iterations: SolverIterations = Field(None, ge=1, le=100, description=LINE_SEARCH_ITERATIONS)


def lacks_solver(options: RunnerOptions) -> Mapping[EngineName, str]:
    """The engines that lack the solver that these options name, and the sentence that refuses each."""
    if options.solver == "newton":
        return {}
    return {"compiled": beyond_compiled(NEWTON_ALONE)}


def check_survives_its_start(height: float, healthy: tuple[float, float], *, terminates: bool) -> None:
    """Raises ValueError if every episode would end in its first step. height: the body's initial height."""
    low, high = healthy
    if terminates and not low <= height <= high:
        raise ValueError(
            f"the body starts at {height:g} m, outside healthy_z_range = [{low:g}, {high:g}], so every "
            "episode would end in its first step; use another range, or terminate_when_unhealthy = false"
        )
