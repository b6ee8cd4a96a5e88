"""A humanoid that learns to walk. Source: Tassa et al., 2012; rewards as in brax.envs.humanoid."""

from typing import Literal, Self

from pydantic import Field, model_validator

from core.documents import Strict
from core.environments.options import NoiseScale, Range, Weight
from core.environments.terms.imitating import (
    IMITATE,
    OBSERVATION,
    check_task,
    imitating_reward,
)
from core.environments.terms.lent import LENT_DECODER, LentDecoder, behind
from core.environments.terms.metrics import Travel
from core.environments.terms.observations import ActuatorForces, BodyInertias, Qpos, Qvel, ShareVelocities
from core.environments.terms.page import noisy, page, survival
from core.environments.terms.reference import Reference
from core.environments.terms.rewards import ControlCost, ForwardVelocity
from core.environments.terms.task import TaskOptions
from core.environments.terms.terminations import FarFromReference, OutsideHeightRange
from core.physics.availability import Rule


class HumanoidOptions(Strict):
    """Brax's options for the humanoid, under Brax's names and with its defaults."""

    task: Literal["walk", "imitate"] = Field(
        "walk", description="imitate: follows the clips of `reference`, by terms of its own (docs/tasks.md)."
    )
    reference: Reference | None = Field(None, description="What it imitates; null: nothing.")
    action: LentDecoder = Field(None, description=LENT_DECODER)
    forward_reward_weight: Weight = Field(1.25, description="Reward for each metre per second in +x.")
    ctrl_cost_weight: Weight = Field(0.1, description="Cost of the control: this times its squared norm.")
    healthy_reward: Weight = Field(5.0, description="Reward for each step.")
    terminate_when_unhealthy: bool = True
    healthy_z_range: Range = Field((1.0, 2.0), description="Healthy heights of the torso, in metres.")
    reset_noise_scale: NoiseScale = Field(1e-2, description="Noise on the initial positions and velocities.")
    exclude_current_positions_from_observation: bool = Field(True, description="Hide x and y.")

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
            "exclude_current_positions_from_observation",
        )
        return self


def _task(options: HumanoidOptions) -> TaskOptions:
    return behind(_imitating(options) if options.task == IMITATE else _walking(options), options.action)


def _imitating(options: HumanoidOptions) -> TaskOptions:
    return TaskOptions(
        reference=options.reference,
        reward=imitating_reward(),
        observation=OBSERVATION,
        termination=[FarFromReference()],
        reset=noisy(options.reset_noise_scale),
        n_frames=5,
    )


def _walking(options: HumanoidOptions) -> TaskOptions:
    alive, ends = survival(options, "alive", [OutsideHeightRange(range=options.healthy_z_range)])
    hides = options.exclude_current_positions_from_observation
    return TaskOptions(
        reward=[
            ForwardVelocity(weight=options.forward_reward_weight, of="centre_of_mass", name="linvel"),
            alive,
            ControlCost(weight=options.ctrl_cost_weight, of="control", name="quadctrl"),
        ],
        observation=[
            Qpos(root_position="height" if hides else "all"),
            Qvel(),
            BodyInertias(),
            ShareVelocities(),
            ActuatorForces(),
        ],
        termination=ends,
        metrics=[Travel(of="centre_of_mass")],
        reset=noisy(options.reset_noise_scale),
        n_frames=5,
    )


HUMANOID = page(
    "humanoid",
    "core.environments.locomotion.model:humanoid",
    _task,
    HumanoidOptions,
    description="A body with two legs, two arms and 17 motors, rewarded for walking in +x and staying up.",
    # Brax reports the term under both names.
    reports={"aliases": {"forward_reward": "reward_linvel"}},
    on_a_cpu=(
        Rule("compiled", 1, "Measured on two cores: physics 17 × that of native; 2.1 × for one environment."),
    ),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 9.8 M control steps/s of physics, 0.86 M by warp."),
        Rule("warp", 1024, "Measured on an H200: 571 k training steps/s, 415 k by mjx."),
    ),
)
