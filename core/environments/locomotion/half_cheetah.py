"""A planar two-legged body that learns to run. Rewards as in brax.envs.half_cheetah."""

from pydantic import Field

from core.documents import Strict
from core.environments.options import NoiseScale, Weight
from core.environments.terms.actions import ControlAction
from core.environments.terms.metrics import Travel
from core.environments.terms.observations import Qpos, Qvel
from core.environments.terms.page import noisy, page
from core.environments.terms.rewards import ControlCost, ForwardVelocity
from core.environments.terms.task import TaskOptions
from core.physics.availability import Rule


class HalfCheetahOptions(Strict):
    """Brax's options for the half cheetah, under Brax's names and with its defaults."""

    forward_reward_weight: Weight = Field(1.0, description="Reward for each metre per second in +x.")
    ctrl_cost_weight: Weight = Field(0.1, description="Cost of an action: this times its squared norm.")
    reset_noise_scale: NoiseScale = Field(0.1, description="Noise on the initial positions and velocities.")
    exclude_current_positions_from_observation: bool = Field(True, description="Hide x.")


def _task(options: HalfCheetahOptions) -> TaskOptions:
    hidden = ["rootx"] if options.exclude_current_positions_from_observation else None
    return TaskOptions(
        reward=[
            ForwardVelocity(weight=options.forward_reward_weight, name="run"),
            ControlCost(weight=options.ctrl_cost_weight, name="ctrl"),
        ],
        observation=[Qpos(without=hidden), Qvel()],
        termination=[],
        metrics=[Travel(report=["x_position", "x_velocity"])],
        action=ControlAction(scaled=False),
        reset=noisy(options.reset_noise_scale, "normal"),
        n_frames=5,
    )


HALF_CHEETAH = page(
    "half_cheetah",
    "core.environments.locomotion.model:plain",
    _task,
    HalfCheetahOptions,
    description="A two-legged body in a plane with six motors, rewarded for running in +x.",
    on_a_cpu=(
        Rule("compiled", 1, "Measured on two cores: physics 11 × that of native; 1.7 × for one environment."),
    ),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 15.6 M control steps/s of physics, 1.12 M by warp."),
        Rule("warp", 1024, "Measured on an H200: 597 k training steps/s, 87 k by mjx."),
    ),
)
