"""A mass on a rail, as a page: its model, its options, its terms, its row."""

from typing import Any

import mujoco
from pydantic import Field

from core.documents import Strict
from core.environments.options import Weight
from core.environments.terms.metrics import Travel
from core.environments.terms.page import noisy, page
from core.environments.terms.rewards import ForwardVelocity
from core.environments.terms.task import TaskOptions
from core.physics.availability import Rule
from core.physics.engine import SolverSettings

_MODEL = """
<mujoco>
  <worldbody>
    <body name="sled">
      <joint name="rail" type="slide" axis="1 0 0" damping="1"/>
      <geom size="0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor joint="rail" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


def model(body: str, options: Any) -> tuple[mujoco.MjSpec, SolverSettings | None]:
    """Every engine keeps the file's solver."""
    return mujoco.MjSpec.from_string(_MODEL), None


class SledOptions(Strict):
    forward_reward_weight: Weight = Field(1.0, description="Reward for each metre per second in +x.")


def _task(options: SledOptions) -> TaskOptions:
    return TaskOptions(
        reward=[ForwardVelocity(weight=options.forward_reward_weight, name="forward")],
        termination=[],
        metrics=[Travel(report=["x_velocity"])],
        reset=noisy(0.1),
        n_frames=10,
    )


INFO = page(
    "sled",
    "tests.unit.environments.sled:model",
    _task,
    SledOptions,
    description="A mass on a rail with one motor, rewarded for moving in +x.",
    on_a_gpu=(Rule("native", 1, "One mass is no work for a GPU."),),
)
