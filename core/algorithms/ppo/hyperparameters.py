"""The numbers of a run that may change without another compilation."""

import jax
import jax.numpy as jnp
from flax import struct

from core.algorithms.ppo.spec import PPOSpec


@struct.dataclass
class Hyperparameters:
    """What may change without recompiling; [] float32 each, infinite where a bound is not set.

    num_updates: of the whole run. Everything else is compiled in.
    """

    learning_rate: jax.Array
    entropy_cost: jax.Array
    desired_kl: jax.Array
    learning_rate_schedule_min_lr: jax.Array
    learning_rate_schedule_max_lr: jax.Array
    discounting: jax.Array
    gae_lambda: jax.Array
    reward_scaling: jax.Array
    clipping_epsilon: jax.Array
    clipping_epsilon_value: jax.Array
    vf_loss_coefficient: jax.Array
    max_grad_norm: jax.Array
    num_updates: jax.Array

    @classmethod
    def of(cls, settings: PPOSpec) -> "Hyperparameters":
        given = {name: getattr(settings, name) for name in settings.arguments}
        numbers = {**given, "num_updates": settings.num_updates}
        return cls(
            **{name: jnp.float32(jnp.inf if value is None else value) for name, value in numbers.items()}
        )
