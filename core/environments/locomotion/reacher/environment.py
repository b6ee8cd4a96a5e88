"""A planar arm that learns to bring its tip to a target. Rewards as in brax.envs.reacher."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np

from core.environments.environment import State
from core.environments.info import NoOptions
from core.environments.mujoco_env import MujocoEnv, initial
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState
from core.physics.model import brax_model

_NUM_SUBSTEPS = 2
_POSITION_NOISE = 0.1
_VELOCITY_NOISE = 0.005
_REACH = 0.2  # metres: how far from the arm's base a target may be
_TIP = np.array([0.11, 0.0, 0.0], np.float32)  # in the frame of the second link
_DERIVED = ("cvel", "subtree_com", "xmat", "xpos")


def make(options: NoOptions, build_engine: EngineBuilder) -> "Reacher":
    """The reacher, moved by the engine that `build_engine` makes."""
    return Reacher(build_engine)


class Reacher(MujocoEnv):
    """Reward: minus the tip's distance to the target, minus the action's cost. It never terminates."""

    def __init__(self, build_engine: EngineBuilder) -> None:
        model = brax_model("reacher")
        super().__init__(
            model,
            build_engine(model, _NUM_SUBSTEPS, _DERIVED),
            num_substeps=_NUM_SUBSTEPS,
            observation_size=11,
            tracked_body="body0",
        )
        self._base = self.tracked_body
        self._second_link: int = model.body("body1").id
        self._target: int = model.body("target").id

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        key_position, key_velocity, key_target = jax.random.split(key, 3)
        noise = jax.random.uniform(key_position, (2,), minval=-_POSITION_NOISE, maxval=_POSITION_NOISE)
        arm = jax.random.uniform(key_velocity, (2,), minval=-_VELOCITY_NOISE, maxval=_VELOCITY_NOISE)
        qpos = jnp.concatenate([self.initial_qpos[:2] + noise, _random_target(key_target)])
        physics = self.engine.reset(qpos, jnp.concatenate([arm, jnp.zeros(2)]), model)
        return initial(self._after(physics, jnp.zeros(self.action_size), {}))

    def step(self, state: State, action: jax.Array) -> State:
        physics = self.engine.step(state.physics, action)
        return self._after(physics, action, state.info)

    def _after(self, physics: PhysicsState, action: jax.Array, info: Mapping[str, jax.Array]) -> State:
        return self.stepped(
            physics,
            self._observe(physics),
            rewards={
                "reward_dist": -jnp.linalg.norm(self._tip(physics) - self._target_position(physics)),
                "reward_ctrl": -jnp.sum(jnp.square(action)),
            },
            done=jnp.zeros(()),
            metrics={},
            info=info,
        )

    def _tip(self, physics: PhysicsState) -> jax.Array:
        """[3] in metres."""
        link = self._second_link
        return physics.derived["xpos"][link] + physics.derived["xmat"][link].reshape(3, 3) @ _TIP

    def _target_position(self, physics: PhysicsState) -> jax.Array:
        """[3] in metres."""
        return physics.derived["xpos"][self._target]

    def _observe(self, physics: PhysicsState) -> jax.Array:
        """Cosines and sines of both joints, target's x and y, tip's velocity in x and y, tip - target."""
        angles = physics.qpos[:2]
        angular, linear = (
            physics.derived["cvel"][self._second_link, :3],
            physics.derived["cvel"][self._second_link, 3:],
        )
        # cvel is taken at the arm's centre of mass. Brax adds the tip's offset in the link's frame, not in
        # the world's, and so do we: Brax's policies and tuned settings are for this observation.
        centre = physics.derived["subtree_com"][self._base]
        offset = physics.derived["xpos"][self._second_link] - centre + _TIP
        velocity = linear + jnp.cross(angular, offset)
        to_tip = self._tip(physics) - self._target_position(physics)
        return jnp.concatenate([jnp.cos(angles), jnp.sin(angles), physics.qpos[2:], velocity[:2], to_tip])


def _random_target(key: jax.Array) -> jax.Array:
    """[2]: uniform in angle and in distance from the base, so denser near it (as in Brax)."""
    key_distance, key_angle = jax.random.split(key)
    distance = _REACH * jax.random.uniform(key_distance)
    angle = 2.0 * jnp.pi * jax.random.uniform(key_angle)
    return distance * jnp.array([jnp.cos(angle), jnp.sin(angle)])
