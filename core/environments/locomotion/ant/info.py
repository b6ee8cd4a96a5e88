"""The ant's row in the catalog."""

from typing import Literal

from pydantic import Field

from core.documents import Strict
from core.environments.bodies import body
from core.environments.body_slices import controls, qpos, qvel
from core.environments.info import EnvironmentInfo
from core.environments.options import NoiseScale, Range, Weight
from core.environments.spaces import Spaces, in_order
from core.physics.availability import Rule


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


def _slices(options: AntOptions) -> Spaces:
    own = body("ant")
    hidden = range(2) if options.exclude_current_positions_from_observation else ()
    return Spaces(in_order([*qpos(own, hidden), *qvel(own)]), in_order(controls(own)))


INFO = EnvironmentInfo(
    id="ant",
    description="A four-legged body with eight motors, rewarded for running in +x and staying up.",
    factory="core.environments.locomotion.ant.environment:make",
    observation_size=27,
    action_size=8,
    dt=0.05,
    episode_length=1000,
    tracked_body="torso",
    cameras=("track",),
    options=AntOptions,
    slices=_slices,
    on_a_cpu=(
        Rule("compiled", 1, "Measured on two cores: physics 24 × that of native; 1.8 × for one environment."),
    ),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 46 M control steps/s of physics, 1.93 M by warp."),
        Rule("warp", 1024, "Measured on an H200: 1.23 M training steps/s, 0.99 M by mjx."),
    ),
)
