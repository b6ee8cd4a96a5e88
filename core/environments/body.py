"""What the bodies of the catalog have in common: a model, an engine that moves it, and its sizes."""

from abc import ABC, abstractmethod

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments.environment import State
from core.physics.engine import NOMINAL, Engine, ModelFields, PhysicsState
from core.physics.model import initial_qpos


class Body(ABC):
    """An environment over one MuJoCo model; a subclass says how it begins, what it sees and what it earns."""

    episode_length = 1000

    def __init__(
        self,
        model: mujoco.MjModel,
        engine: Engine,
        *,
        num_substeps: int,
        observation_size: int,
        tracked_body: str | int,
    ) -> None:
        self.model = model
        self.engine = engine
        self.dt = model.opt.timestep * num_substeps
        self.observation_size = observation_size
        self.action_size: int = model.nu
        self.tracked_body: int = model.body(tracked_body).id
        self.initial_qpos = jnp.asarray(initial_qpos(model), jnp.float32)

    @abstractmethod
    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State: ...

    @abstractmethod
    def step(self, state: State, action: jax.Array) -> State: ...


def noisy_start(
    body: Body, key: jax.Array, model: ModelFields, scale: float, *, normal_velocity: bool
) -> PhysicsState:
    """The model's initial state with uniform noise in ±scale on the positions, and noise on the velocities.

    normal_velocity: velocities are normal with deviation `scale`; otherwise uniform in ±scale.
    """
    key_position, key_velocity = jax.random.split(key)
    qpos = body.initial_qpos + jax.random.uniform(key_position, (body.model.nq,), minval=-scale, maxval=scale)
    if normal_velocity:
        qvel = scale * jax.random.normal(key_velocity, (body.model.nv,))
    else:
        qvel = jax.random.uniform(key_velocity, (body.model.nv,), minval=-scale, maxval=scale)
    return body.engine.reset(qpos, qvel, model)


def height_is_healthy(height: jax.Array, healthy_range: tuple[float, float]) -> jax.Array:
    """1 where the height [] lies in the range, its ends included, otherwise 0; 1 also for NaN."""
    low, high = healthy_range
    return jnp.where((height < low) | (height > high), 0.0, 1.0)


def scaled_to_control(model: mujoco.MjModel, action: jax.Array) -> jax.Array:
    """The control [nu] for an action [nu] in [-1, 1]: its ends are the ends of the actuators' ranges."""
    low, high = np.asarray(model.actuator_ctrlrange, np.float32).T
    return low + (action + 1.0) * (high - low) * 0.5
