"""The humanoid's row in the catalog."""

from pydantic import Field

from core.documents import Strict
from core.environments.bodies import body
from core.environments.body_slices import CVEL, controls, qfrc_actuator, qpos, qvel, rows
from core.environments.info import EnvironmentInfo
from core.environments.options import NoiseScale, Range, Weight
from core.environments.spaces import Spaces, in_order
from core.physics.availability import Rule

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


def _slices(options: HumanoidOptions) -> Spaces:
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


INFO = EnvironmentInfo(
    id="humanoid",
    description="A body with two legs, two arms and 17 motors, rewarded for walking in +x and staying up.",
    factory="core.environments.locomotion.humanoid.environment:make",
    observation_size=244,
    action_size=17,
    dt=0.015,
    episode_length=1000,
    tracked_body="torso",
    cameras=("track",),
    options=HumanoidOptions,
    slices=_slices,
    on_a_cpu=(
        Rule("compiled", 1, "Measured on two cores: physics 17 × that of native; 2.1 × for one environment."),
    ),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 9.8 M control steps/s of physics, 0.86 M by warp."),
        Rule("warp", 1024, "Measured on an H200: 571 k training steps/s, 415 k by mjx."),
    ),
)
