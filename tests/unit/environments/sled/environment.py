"""A mass on a rail."""

import jax
import jax.numpy as jnp
import mujoco

from core.environments.environment import State
from core.environments.info import NoOptions
from core.environments.mujoco_env import MujocoEnv, noisy_start
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState

_NUM_SUBSTEPS = 10
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


def make(options: NoOptions, build_engine: EngineBuilder) -> "Sled":
    return Sled(build_engine)


class Sled(MujocoEnv):
    """Reward: the velocity in +x, in m/s."""

    episode_length = 100

    def __init__(self, build_engine: EngineBuilder) -> None:
        model = mujoco.MjModel.from_xml_string(_MODEL)
        super().__init__(
            model,
            build_engine(model, _NUM_SUBSTEPS, ()),
            num_substeps=_NUM_SUBSTEPS,
            observation_size=2,
            tracked_body="sled",
        )

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        physics = noisy_start(self, key, model, 0.1, normal_velocity=False)
        zero = jnp.zeros(())
        return State(physics, _observe(physics), zero, zero, {"x_velocity": zero}, {})

    def step(self, state: State, action: jax.Array) -> State:
        physics = self.engine.step(state.physics, action)
        velocity = physics.qvel[0]
        return State(
            physics, _observe(physics), velocity, jnp.zeros(()), {"x_velocity": velocity}, state.info
        )


def _observe(physics: PhysicsState) -> jax.Array:
    return jnp.concatenate([physics.qpos, physics.qvel])
