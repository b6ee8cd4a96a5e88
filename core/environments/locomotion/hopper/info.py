"""The hopper's row in the catalog."""

from pydantic import Field

from core.documents import Strict
from core.environments.info import EnvironmentInfo
from core.environments.locomotion.planar_slices import planar_slices
from core.environments.options import NoiseScale, OpenRange, Range, Weight
from core.physics.availability import Rule


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


INFO = EnvironmentInfo(
    id="hopper",
    description="A one-legged body in a plane with three motors, rewarded for hopping in +x and staying up.",
    factory="core.environments.locomotion.hopper.environment:make",
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
