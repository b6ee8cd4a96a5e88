"""The planar walker's row in the catalog."""

from pydantic import Field

from core.documents import Strict
from core.environments.info import EnvironmentInfo
from core.environments.locomotion.planar_slices import planar_slices
from core.environments.options import NoiseScale, Range, Weight
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


INFO = EnvironmentInfo(
    id="walker2d",
    description="A two-legged body in a plane with six motors, rewarded for walking in +x and staying up.",
    factory="core.environments.locomotion.walker2d.environment:make",
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
