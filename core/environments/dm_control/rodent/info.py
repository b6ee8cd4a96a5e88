"""A rat that learns to run. Source: Merel et al., 2020, for the body; rewards as in the tutorial notebook."""

from collections.abc import Mapping
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from core.environments.options import (
    LINE_SEARCH_ITERATIONS,
    SOLVER_ITERATIONS,
    Range,
    RunnerOptions,
    SolverIterations,
    check_survives_its_start,
    lacks_solver,
)
from core.environments.terms.actions import ControlAction
from core.environments.terms.imitating import (
    IMITATE,
    OBSERVATION,
    check_task,
    imitating_reward,
)
from core.environments.terms.imitation import TrackRootPosition
from core.environments.terms.lent import LENT_DECODER, LentDecoder, behind
from core.environments.terms.metrics import Travel
from core.environments.terms.observations import Activation, ActuatorForces, Cinert, Cvel, Qpos, Qvel
from core.environments.terms.page import noisy, page, survival
from core.environments.terms.reference import Reference
from core.environments.terms.rewards import ControlCost, ForwardVelocity
from core.environments.terms.task import Reset, TaskOptions
from core.environments.terms.terminations import FarFromReference, OutsideHeightRange
from core.patterns import PATTERNS, Patterns
from core.physics.availability import Rule

STANDING_HEIGHT_M = 0.047

# Without the tail: recordings of rats have no key points on it.
_BODIES = ["torso", "pelvis", "skull", ".*_(leg|arm)_.*", "(foot|scapula|hand)_.*"]
_JOINTS = ["vertebra_([1-6]|cervical|axis|atlant).*", "(hip|knee|ankle|toe|scapula|shoulder|elbow|wrist).*"]
# A rat's size, as a share of a human's.
_SIZE = 0.15
# The wide one leads the root to where the narrow one tells millimetres apart.
_ROOT = [
    TrackRootPosition(weight=1.5, tolerance=0.04),
    TrackRootPosition(weight=2.0, tolerance=0.01, name="track_root_closely"),
]
# Feet of a rat that gallops are further off than a human's of its size would be.
_LOST = FarFromReference(root_position=0.075, anchor_height=0.05, end_effector_height=0.05)


class RatReference(Reference):
    """What the rat follows; by default its tail, jaw and digits are not compared."""

    bodies: Patterns | None = Field(default=_BODIES, description=f"The bodies that are compared. {PATTERNS}")
    end_effectors: Patterns | None = Field(
        default=["skull", "(foot|hand)_.*"], description=f"Such as feet. {PATTERNS}"
    )


class RodentOptions(RunnerOptions):
    """The options of the rodent, its reward and its physics."""

    task: Literal["run", "imitate"] = Field(
        "run", description="imitate: follows the clips of `reference`, by terms of its own (docs/tasks.md)."
    )
    reference: RatReference | None = Field(None, description="What it imitates; null: nothing.")
    action: LentDecoder = Field(None, description=LENT_DECODER)
    terminate_when_unhealthy: bool = Field(
        True, description="false: an unhealthy step only loses the healthy reward."
    )
    healthy_z_range: Range = Field(
        (0.03, 0.3),
        description=f"Healthy heights of the torso, in metres: it stands at {STANDING_HEIGHT_M}, runs above "
        "0.033, and has fallen below 0.03.",
    )
    exclude_current_positions_from_observation: bool = Field(False, description="Hide x and y.")
    # With two iterations the solver (Newton's) is so far off that the body flies apart, even in float64.
    iterations: SolverIterations = Field(None, ge=3, le=100, description=SOLVER_ITERATIONS)
    ls_iterations: SolverIterations = Field(None, ge=4, le=100, description=LINE_SEARCH_ITERATIONS)

    @model_validator(mode="after")
    def _fits_its_task(self) -> Self:
        check_task(
            self,
            self.task,
            self.reference,
            "forward_reward_weight",
            "ctrl_cost_weight",
            "healthy_reward",
            "terminate_when_unhealthy",
            "healthy_z_range",
            "reset_noise_scale",
            "exclude_current_positions_from_observation",
        )
        return self

    @model_validator(mode="after")
    def _stands(self) -> Self:
        terminates = self.terminate_when_unhealthy and self.task != IMITATE
        check_survives_its_start(STANDING_HEIGHT_M, self.healthy_z_range, terminates=terminates)
        return self


def _under(options: RodentOptions) -> Mapping[str, Any]:
    """The fields of the row that these options change."""
    return {"cannot_run": lacks_solver(options)}


def _task(options: RodentOptions) -> TaskOptions:
    return behind(_imitating(options) if options.task == IMITATE else _running(options), options.action)


def _imitating(options: RodentOptions) -> TaskOptions:
    return TaskOptions(
        reference=options.reference,
        reward=imitating_reward(_SIZE, _JOINTS, _ROOT),
        observation=[*OBSERVATION, Activation()],
        termination=[_LOST],
        action=ControlAction(scaled=False),
        reset=Reset(position_noise=0.002, velocity_noise=0.01),
        n_frames=options.n_frames,
        timestep=options.timestep,
    )


def _running(options: RodentOptions) -> TaskOptions:
    alive, ends = survival(options, "alive", [OutsideHeightRange(range=options.healthy_z_range)])
    hides, noise = options.exclude_current_positions_from_observation, options.reset_noise_scale
    return TaskOptions(
        reward=[
            ForwardVelocity(weight=options.forward_reward_weight, of="centre_of_mass", name="linvel"),
            alive,
            ControlCost(weight=options.ctrl_cost_weight, name="quadctrl"),
        ],
        observation=[
            Qpos(root_position="height" if hides else "all"),
            Qvel(),
            Cinert(),
            Cvel(),
            ActuatorForces(),
        ],
        termination=ends,
        metrics=[Travel(report=["height"]), Travel(of="centre_of_mass")],
        action=ControlAction(scaled=False),
        # Raised by the noise's size: a body that noise pushes into the floor is thrown up.
        reset=noisy(noise, lift=noise),
        n_frames=options.n_frames,
        timestep=options.timestep,
    )


INFO = page(
    "rodent",
    "core.environments.dm_control.rodent.model:rodent",
    _task,
    RodentOptions,
    description="dm_control's rat: 67 joints and 38 actuators, rewarded for running in +x and staying up.",
    # The notebook reports the term under both names, as Brax's humanoid does.
    reports={"aliases": {"forward_reward": "reward_linvel"}},
    package="dm_control",
    vary=_under,
    on_a_cpu=(Rule("compiled", 16, "Measured on two cores: 6.3 k training steps/s, 1.8 k by native."),),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 230 k control steps/s of physics, 136 k by warp."),
        Rule("warp", 1, "Measured on an H200: 133 k control steps/s of physics, 21 k by mjx."),
        Rule("native", 1, "MJX takes many minutes to compile the training, for 21 k steps/s on an H200."),
    ),
)
