"""The rows of these bodies in the catalog: options, sizes, observations, and which engine to take where."""

from typing import Literal

from pydantic import Field

from core.documents import Strict
from core.environments.bodies import CVEL, body, controls, qfrc_actuator, qpos, qvel, rows
from core.environments.info import EnvironmentInfo, NoOptions, Spaces, in_order, named
from core.environments.options import NoiseScale, OpenRange, Range, Weight
from core.physics.availability import Rule

MAX_OBSERVED_SPEED = 10.0


def planar_slices(name: str, hides_x: bool) -> Spaces:
    """name: of the environment. In place of the joint `rootz` stands the torso's height."""
    own = body(name)
    seen = [*qpos(own, range(1) if hides_x else (), {1: "torso height"}), *qvel(own, MAX_OBSERVED_SPEED)]
    return Spaces(in_order(seen), in_order(controls(own)))


class AntOptions(Strict):
    """Brax's options for the ant, under Brax's names and with its defaults."""

    ctrl_cost_weight: Weight = Field(0.5, description="Cost of an action: this times its squared norm.")
    use_contact_forces: Literal[False] = Field(False, description="Brax does not implement it either.")
    contact_cost_weight: Weight = Field(5e-4, description="Without effect: contact forces are not used.")
    healthy_reward: Weight = Field(1.0, description="Reward for each step.")
    terminate_when_unhealthy: bool = True
    healthy_z_range: Range = Field((0.2, 1.0), description="Healthy heights of the torso, in metres.")
    contact_force_range: Range = Field((-1.0, 1.0), description="Without effect, as contact_cost_weight.")
    reset_noise_scale: NoiseScale = Field(0.1, description="Noise on the initial positions and velocities.")
    exclude_current_positions_from_observation: bool = Field(True, description="Hide x and y.")


def _ant_slices(options: AntOptions) -> Spaces:
    own = body("ant")
    hidden = range(2) if options.exclude_current_positions_from_observation else ()
    return Spaces(in_order([*qpos(own, hidden), *qvel(own)]), in_order(controls(own)))


ANT = EnvironmentInfo(
    id="ant",
    description="A four-legged body with eight motors, rewarded for running in +x and staying up.",
    factory="core.environments.locomotion.ant:make",
    observation_size=27,
    action_size=8,
    dt=0.05,
    episode_length=1000,
    tracked_body="torso",
    cameras=("track",),
    options=AntOptions,
    slices=_ant_slices,
    on_a_cpu=(
        Rule("compiled", 1, "Measured on two cores: physics 24 × that of native; 1.8 × for one environment."),
    ),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 46 M control steps/s of physics, 1.93 M by warp."),
        Rule("warp", 1024, "Measured on an H200: 1.23 M training steps/s, 0.99 M by mjx."),
    ),
)


class HalfCheetahOptions(Strict):
    """Brax's options for the half cheetah, under Brax's names and with its defaults."""

    forward_reward_weight: Weight = Field(1.0, description="Reward for each metre per second in +x.")
    ctrl_cost_weight: Weight = Field(0.1, description="Cost of an action: this times its squared norm.")
    reset_noise_scale: NoiseScale = Field(0.1, description="Noise on the initial positions and velocities.")
    exclude_current_positions_from_observation: bool = Field(True, description="Hide x.")


def _half_cheetah_slices(options: HalfCheetahOptions) -> Spaces:
    own = body("half_cheetah")
    hidden = range(1) if options.exclude_current_positions_from_observation else ()
    return Spaces(in_order([*qpos(own, hidden), *qvel(own)]), in_order(controls(own)))


HALF_CHEETAH = EnvironmentInfo(
    id="half_cheetah",
    description="A two-legged body in a plane with six motors, rewarded for running in +x.",
    factory="core.environments.locomotion.half_cheetah:make",
    observation_size=17,
    action_size=6,
    dt=0.05,
    episode_length=1000,
    tracked_body="torso",
    cameras=("track",),
    options=HalfCheetahOptions,
    slices=_half_cheetah_slices,
    on_a_cpu=(
        Rule("compiled", 1, "Measured on two cores: physics 11 × that of native; 1.7 × for one environment."),
    ),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 15.6 M control steps/s of physics, 1.12 M by warp."),
        Rule("warp", 1024, "Measured on an H200: 597 k training steps/s, 87 k by mjx."),
    ),
)


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


HOPPER = EnvironmentInfo(
    id="hopper",
    description="A one-legged body in a plane with three motors, rewarded for hopping in +x and staying up.",
    factory="core.environments.locomotion.planar:hopper",
    observation_size=11,
    action_size=3,
    dt=0.008,
    episode_length=1000,
    tracked_body="torso",
    cameras=("track",),
    options=HopperOptions,
    slices=lambda options: planar_slices("hopper", options.exclude_current_positions_from_observation),
    on_a_cpu=(
        Rule("compiled", 1, "Measured on two cores: physics 12 × that of native; 1.8 × for one environment."),
    ),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 26.2 M control steps/s of physics, 1.37 M by warp."),
        Rule("warp", 1024, "Measured on an H200: 1.04 M training steps/s, 141 k by mjx."),
    ),
)


# A symmetric matrix row by row, and the mass; CVEL begins with the angular velocity.
_INERTIA = ("Ixx", "Ixy", "Ixz", "Ixy", "Iyy", "Iyz", "Ixz", "Iyz", "Izz", "m")
_VELOCITY = (*CVEL[3:], *CVEL[:3])


class HumanoidOptions(Strict):
    """Brax's options for the humanoid, under Brax's names and with its defaults."""

    forward_reward_weight: Weight = Field(1.25, description="Reward for each metre per second in +x.")
    ctrl_cost_weight: Weight = Field(0.1, description="Cost of the control: this times its squared norm.")
    healthy_reward: Weight = Field(5.0, description="Reward for each step.")
    terminate_when_unhealthy: bool = True
    healthy_z_range: Range = Field((1.0, 2.0), description="Healthy heights of the torso, in metres.")
    reset_noise_scale: NoiseScale = Field(1e-2, description="Noise on the initial positions and velocities.")
    exclude_current_positions_from_observation: bool = Field(True, description="Hide x and y.")


def _humanoid_slices(options: HumanoidOptions) -> Spaces:
    own = body("humanoid")
    hidden = range(2) if options.exclude_current_positions_from_observation else ()
    seen = [
        *qpos(own, hidden),
        *qvel(own),
        rows("inertia", own.bodies, _INERTIA, "kg m², kg"),
        rows("velocity", own.bodies, _VELOCITY, "m/s, rad/s"),
        *qfrc_actuator(own),
    ]
    return Spaces(in_order(seen), in_order(controls(own)))


HUMANOID = EnvironmentInfo(
    id="humanoid",
    description="A body with two legs, two arms and 17 motors, rewarded for walking in +x and staying up.",
    factory="core.environments.locomotion.humanoid:make",
    observation_size=244,
    action_size=17,
    dt=0.015,
    episode_length=1000,
    tracked_body="torso",
    cameras=("track",),
    options=HumanoidOptions,
    slices=_humanoid_slices,
    on_a_cpu=(
        Rule("compiled", 1, "Measured on two cores: physics 17 × that of native; 2.1 × for one environment."),
    ),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 9.8 M control steps/s of physics, 0.86 M by warp."),
        Rule("warp", 1024, "Measured on an H200: 571 k training steps/s, 415 k by mjx."),
    ),
)


def _inverted_pendulum_slices(_: NoOptions) -> Spaces:
    own = body("inverted_pendulum")
    return Spaces(in_order([*qpos(own), *qvel(own)]), in_order(controls(own)))


INVERTED_PENDULUM = EnvironmentInfo(
    id="inverted_pendulum",
    description="A pole on a cart with one motor, rewarded for each step in which the pole stands.",
    factory="core.environments.locomotion.inverted_pendulum:make",
    observation_size=4,
    action_size=1,
    dt=0.04,
    episode_length=1000,
    tracked_body="cart",
    slices=_inverted_pendulum_slices,
    on_a_gpu=(Rule("warp", 1024, "Measured on an H200: 1.54 M training steps/s, 635 k by mjx."),),
)


def _reacher_slices(_: NoOptions) -> Spaces:
    seen = [
        named("cosine", ("joint0", "joint1"), "1", -1.0, 1.0),
        named("sine", ("joint0", "joint1"), "1", -1.0, 1.0),
        named("target_position", ("x", "y"), "m"),
        named("tip_velocity", ("x", "y"), "m/s"),
        named("target_to_tip", ("x", "y", "z"), "m"),
    ]
    return Spaces(in_order(seen), in_order(controls(body("reacher"))))


REACHER = EnvironmentInfo(
    id="reacher",
    description="An arm of two links in a plane, rewarded for bringing its tip to a target.",
    factory="core.environments.locomotion.reacher:make",
    observation_size=11,
    action_size=2,
    dt=0.02,
    episode_length=1000,
    tracked_body="body0",
    slices=_reacher_slices,
    on_a_cpu=(Rule("compiled", 1, "Measured on two cores: 1.6 × the training steps/s of native."),),
    on_a_gpu=(Rule("warp", 1024, "Measured on an H200: 921 k training steps/s, 306 k by mjx."),),
)


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


WALKER2D = EnvironmentInfo(
    id="walker2d",
    description="A two-legged body in a plane with six motors, rewarded for walking in +x and staying up.",
    factory="core.environments.locomotion.planar:walker2d",
    observation_size=17,
    action_size=6,
    dt=0.008,
    episode_length=1000,
    tracked_body="torso",
    cameras=("track",),
    options=Walker2dOptions,
    slices=lambda options: planar_slices("walker2d", options.exclude_current_positions_from_observation),
    on_a_cpu=(
        Rule("compiled", 1, "Measured on two cores: physics 10 × that of native; 1.7 × for one environment."),
    ),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 12.2 M control steps/s of physics, 1.19 M by warp."),
        Rule("warp", 1024, "Measured on an H200: 905 k training steps/s, 114 k by mjx."),
    ),
)
