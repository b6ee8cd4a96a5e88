"""A four-legged body that learns to run. Source: Schulman et al., 2015; rewards as in brax.envs.ant."""

from typing import Literal

from pydantic import Field

from core.documents import Strict
from core.environments.options import NoiseScale, Range, Weight
from core.environments.terms.actions import ControlAction
from core.environments.terms.metrics import Travel
from core.environments.terms.observations import Qpos, Qvel
from core.environments.terms.page import noisy, page, survival
from core.environments.terms.rewards import Alive, ControlCost, ForwardVelocity
from core.environments.terms.task import TaskOptions
from core.environments.terms.terminations import OutsideHeightRange
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


def _task(options: AntOptions) -> TaskOptions:
    survive, ends = survival(options, "survive", [OutsideHeightRange(range=options.healthy_z_range)])
    hides = options.exclude_current_positions_from_observation
    return TaskOptions(
        reward=[
            ForwardVelocity(name="forward"),
            survive,
            ControlCost(weight=options.ctrl_cost_weight, name="ctrl"),
            # Brax has the term, and no contact forces for it.
            Alive(weight=0.0, name="contact"),
        ],
        observation=[Qpos(root_position="height" if hides else "all"), Qvel()],
        termination=ends,
        metrics=[Travel()],
        action=ControlAction(scaled=False),
        reset=noisy(options.reset_noise_scale, "normal"),
        n_frames=5,
    )


ANT = page(
    "ant",
    "core.environments.locomotion.model:ant",
    _task,
    AntOptions,
    description="A four-legged body with eight motors, rewarded for running in +x and staying up.",
    # Brax reports the term under both names.
    reports={"aliases": {"forward_reward": "reward_forward"}},
    on_a_cpu=(
        Rule("compiled", 1, "Measured on two cores: physics 24 × that of native; 1.8 × for one environment."),
    ),
    on_a_gpu=(
        Rule("compiled", 1, "Measured on an H200: 46 M control steps/s of physics, 1.93 M by warp."),
        Rule("warp", 1024, "Measured on an H200: 1.23 M training steps/s, 0.99 M by mjx."),
    ),
)
