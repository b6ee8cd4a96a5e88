"""A mass on a rail."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import mujoco

from core.environments.environment import State
from core.environments.info import NoOptions
from core.environments.mujoco_env import MujocoEnv, initial, noisy_start, scaled_to_control
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
        return initial(self._after(physics, {}))

    def step(self, state: State, action: jax.Array) -> State:
        physics = self.engine.step(state.physics, scaled_to_control(self.model, action))
        return self._after(physics, state.info)

    def _after(self, physics: PhysicsState, info: Mapping[str, jax.Array]) -> State:
        velocity = physics.qvel[0]
        return self.stepped(
            physics,
            _observe(physics),
            rewards={"reward_forward": velocity},
            done=jnp.zeros(()),
            metrics={"x_velocity": velocity},
            info=info,
        )


def _observe(physics: PhysicsState) -> jax.Array:
    return jnp.concatenate([physics.qpos, physics.qvel])
