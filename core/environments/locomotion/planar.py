"""The hopper and the planar walker: a torso on x, z and pitch that must not fall.

Rewards as in brax.envs.hopper and brax.envs.walker2d.
"""

from collections.abc import Sequence

from pydantic import Field

from core.documents import Strict
from core.environments.options import NoiseScale, OpenRange, Range, Weight
from core.environments.terms.actions import ControlAction
from core.environments.terms.metrics import Travel
from core.environments.terms.observations import Height, Qpos, Qvel
from core.environments.terms.page import noisy, page, survival
from core.environments.terms.rewards import ControlCost, ForwardVelocity
from core.environments.terms.task import TaskOptions
from core.environments.terms.terminations import AnyTermination, OutsideHeightRange, OutsideJointRange
from core.environments.terms.vocabulary import AnyObservation
from core.physics.availability import Rule


class Walker2dOptions(Strict):
    """Brax's options for the planar walker, under Brax's names and with its defaults."""

    forward_reward_weight: Weight = Field(1.0, description="Reward for each metre per second in +x.")
    ctrl_cost_weight: Weight = Field(1e-3, description="Cost of an action: this times its squared norm.")
    healthy_reward: Weight = Field(1.0, description="Reward for each step.")
    terminate_when_unhealthy: bool = True
    healthy_z_range: Range = Field((0.8, 2.0), description="Healthy heights of the torso, in metres.")
    healthy_angle_range: Range = Field((-1.0, 1.0), description="Healthy pitches of the torso, in radians.")
    reset_noise_scale: NoiseScale = Field(5e-3, description="Noise on the initial positions and velocities.")
    exclude_current_positions_from_observation: bool = Field(True, description="Hide x.")


class HopperOptions(Strict):
    """Brax's options for the hopper, under Brax's names and with its defaults."""

    forward_reward_weight: Weight = Field(1.0, description="Reward for each metre per second in +x.")
    ctrl_cost_weight: Weight = Field(1e-3, description="Cost of an action: this times its squared norm.")
    healthy_reward: Weight = Field(1.0, description="Reward for each step.")
    terminate_when_unhealthy: bool = True
    healthy_state_range: Range = Field(
        (-100.0, 100.0), description="Healthy angles and velocities of every joint, each in its own unit."
    )
    healthy_z_range: OpenRange = Field((0.7, None), description="Healthy heights of the torso, in metres.")
    healthy_angle_range: Range = Field((-0.2, 0.2), description="Healthy pitches of the torso, in radians.")
    reset_noise_scale: NoiseScale = Field(5e-3, description="Noise on the initial positions and velocities.")
    exclude_current_positions_from_observation: bool = Field(True, description="Hide x.")


def _task(options: HopperOptions | Walker2dOptions, other_ends: Sequence[AnyTermination] = ()) -> TaskOptions:
    """other_ends: what else is unhealthy than the torso's height and pitch."""
    ends: list[AnyTermination] = [
        OutsideHeightRange(range=options.healthy_z_range),
        OutsideJointRange(joints=["rooty"], range=options.healthy_angle_range),
        *other_ends,
    ]
    healthy, ends_episode = survival(options, "healthy", ends)
    x: list[AnyObservation] = [Qpos(without=["rootz", "rooty", ".*_joint"])]
    return TaskOptions(
        reward=[
            ForwardVelocity(weight=options.forward_reward_weight, name="forward"),
            healthy,
            ControlCost(weight=options.ctrl_cost_weight, name="ctrl"),
        ],
        observation=[
            *(x if not options.exclude_current_positions_from_observation else []),
            Height(),
            Qpos(without=["rootx", "rootz"]),
            Qvel(clip=10.0),
        ],
        termination=ends_episode,
        metrics=[Travel(report=["x_position", "x_velocity"])],
        action=ControlAction(scaled=False),
        reset=noisy(options.reset_noise_scale),
        n_frames=4,
    )


def _hopper(options: HopperOptions) -> TaskOptions:
    joints, healthy = ["rooty", ".*_joint"], options.healthy_state_range
    positions = OutsideJointRange(joints=joints, range=healthy)
    return _task(options, [positions, OutsideJointRange(joints=[".*"], range=healthy, of="velocity")])


HOPPER = page(
    "hopper",
    "core.environments.locomotion.model:plain",
    _hopper,
    HopperOptions,
    description="A one-legged body in a plane with three motors, rewarded for hopping in +x and staying up.",
    on_a_cpu=(
        Rule("compiled", 1, "Measured on two cores: physics 12 × that of native; 1.8 × for one environment."),
    ),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 26.2 M control steps/s of physics, 1.37 M by warp."),
        Rule("warp", 1024, "Measured on an H200: 1.04 M training steps/s, 141 k by mjx."),
    ),
)

WALKER2D = page(
    "walker2d",
    "core.environments.locomotion.model:plain",
    _task,
    Walker2dOptions,
    description="A two-legged body in a plane with six motors, rewarded for walking in +x and staying up.",
    on_a_cpu=(
        Rule("compiled", 1, "Measured on two cores: physics 10 × that of native; 1.7 × for one environment."),
    ),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 12.2 M control steps/s of physics, 1.19 M by warp."),
        Rule("warp", 1024, "Measured on an H200: 905 k training steps/s, 114 k by mjx."),
    ),
)
