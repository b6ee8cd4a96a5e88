"""The rodent's row in the catalog."""

from collections.abc import Mapping
from functools import cache
from typing import Any, Self

from pydantic import Field, model_validator

from core.environments.bodies import CINERT, CVEL, body, controls, qfrc_actuator, qpos, qvel, rows
from core.environments.info import EnvironmentInfo, Spaces, in_order
from core.environments.options import (
    LINE_SEARCH_ITERATIONS,
    SOLVER_ITERATIONS,
    Range,
    RunnerOptions,
    SolverIterations,
    check_survives_its_start,
    lacks_solver,
)
from core.physics.availability import Rule

STANDING_HEIGHT_M = 0.047


class RodentOptions(RunnerOptions):
    """The options of the rodent, its reward and its physics."""

    terminate_when_unhealthy: bool = Field(
        True, description="false: an unhealthy step only loses the healthy reward."
    )
    healthy_z_range: Range = Field(
        (0.03, 0.3),
        description=f"Healthy heights of the torso, in metres: it stands at {STANDING_HEIGHT_M}, runs above "
        "0.033, and has fallen below 0.03.",
    )
    exclude_current_positions_from_observation: bool = Field(False, description="Hide x and y.")
    # With two iterations of Newton's method the body flies apart, even in float64.
    iterations: SolverIterations = Field(None, ge=3, le=100, description=SOLVER_ITERATIONS)
    ls_iterations: SolverIterations = Field(None, ge=4, le=100, description=LINE_SEARCH_ITERATIONS)

    @model_validator(mode="after")
    def _stands(self) -> Self:
        terminates = self.terminate_when_unhealthy
        check_survives_its_start(STANDING_HEIGHT_M, self.healthy_z_range, terminates=terminates)
        return self


def _under(options: RodentOptions) -> Mapping[str, Any]:
    """The fields of the row that these options change."""
    return {"cannot_run": lacks_solver(options)}


@cache
def _slices(hides_x_and_y: bool) -> Spaces:
    own = body("rodent")
    seen = [
        *qpos(own, range(2) if hides_x_and_y else ()),
        *qvel(own),
        rows("cinert", own.bodies, CINERT, "kg m², kg m, kg"),
        rows("cvel", own.bodies, CVEL, "rad/s, m/s"),
        *qfrc_actuator(own),
    ]
    return Spaces(in_order(seen), in_order(controls(own)))


INFO = EnvironmentInfo(
    id="rodent",
    description="dm_control's rat: 67 joints and 38 actuators, rewarded for running in +x and staying up.",
    factory="core.environments.dm_control.rodent.environment:make",
    package="dm_control",
    observation_size=1260,
    action_size=38,
    dt=0.01,
    episode_length=1000,
    tracked_body="torso",
    cameras=("back", "side", "side_alt", "top", "egocentric"),
    options=RodentOptions,
    vary=_under,
    slices=lambda options: _slices(options.exclude_current_positions_from_observation),
    on_a_cpu=(Rule("compiled", 16, "Measured on two cores: 6.3 k training steps/s, 1.8 k by native."),),
    on_a_gpu=(
        Rule("warp", 1, "Measured on an H200: 133 k control steps/s of physics, 21 k by mjx."),
        Rule("native", 1, "MJX takes many minutes to compile the training, for 21 k steps/s on an H200."),
    ),
)
