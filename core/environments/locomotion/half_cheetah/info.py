"""The half cheetah's row in the catalog."""

from pydantic import Field

from core.documents import Strict
from core.environments.bodies import body
from core.environments.body_slices import controls, qpos, qvel
from core.environments.info import EnvironmentInfo
from core.environments.options import NoiseScale, Weight
from core.environments.spaces import Spaces, in_order
from core.physics.availability import Rule


class HalfCheetahOptions(Strict):
    """Brax's options for the half cheetah, under Brax's names and with its defaults."""

    forward_reward_weight: Weight = Field(1.0, description="Reward for each metre per second in +x.")
    ctrl_cost_weight: Weight = Field(0.1, description="Cost of an action: this times its squared norm.")
    reset_noise_scale: NoiseScale = Field(0.1, description="Noise on the initial positions and velocities.")
    exclude_current_positions_from_observation: bool = Field(True, description="Hide x.")


def _slices(options: HalfCheetahOptions) -> Spaces:
    own = body("half_cheetah")
    hidden = range(1) if options.exclude_current_positions_from_observation else ()
    return Spaces(in_order([*qpos(own, hidden), *qvel(own)]), in_order(controls(own)))


INFO = EnvironmentInfo(
    id="half_cheetah",
    description="A two-legged body in a plane with six motors, rewarded for running in +x.",
    factory="core.environments.locomotion.half_cheetah.environment:make",
    observation_size=17,
    action_size=6,
    dt=0.05,
    episode_length=1000,
    tracked_body="torso",
    cameras=("track",),
    options=HalfCheetahOptions,
    slices=_slices,
    on_a_cpu=(
        Rule("compiled", 1, "Measured on two cores: physics 11 × that of native; 1.7 × for one environment."),
    ),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 15.6 M control steps/s of physics, 1.12 M by warp."),
        Rule("warp", 1024, "Measured on an H200: 597 k training steps/s, 87 k by mjx."),
    ),
)
