"""Acting: the transitions that one update learns from."""

from typing import Any, cast

import jax
import jax.numpy as jnp
from brax.training.types import Transition
from flax import struct

from core.environments.environment import Environment
from core.environments.wrappers import Episodes, step_episodes

Policy = Any  # (observations [B, obs], key) -> (actions [B, act], extras)


@struct.dataclass
class Outcome:
    """What happened at each of T steps in N environments; arrays [T, N]."""

    reward: jax.Array
    ended_length: jax.Array
    ended_score: jax.Array
    x_velocity: jax.Array | None


def collect(
    environment: Environment,
    policy: Policy,
    episodes: Episodes,
    key: jax.Array,
    *,
    num_steps: int,
    episode_length: int,
) -> tuple[Episodes, tuple[Transition, Outcome]]:
    """Act for `num_steps`; the transitions and outcomes lead with [num_steps, num_envs]."""

    def act(episodes: Episodes, key: jax.Array) -> tuple[Episodes, tuple[Transition, Outcome]]:
        action, extras = policy(episodes.state.obs, key)
        after = step_episodes(environment, episodes, action, episode_length=episode_length)
        transition = Transition(
            observation=episodes.state.obs,
            action=(),  # pyright: ignore[reportArgumentType]
            reward=after.state.reward,
            discount=1 - after.state.done,
            next_observation=after.state.obs,
            extras=cast("Any", {"policy_extras": extras, "state_extras": {"truncation": after.truncated}}),
        )
        outcome = Outcome(
            reward=after.state.reward,
            ended_length=after.ended_length,
            ended_score=after.ended_score,
            x_velocity=after.state.metrics.get("x_velocity"),
        )
        return after, (transition, outcome)

    return jax.lax.scan(act, episodes, jax.random.split(key, num_steps))


def cut_into_unrolls(transitions: Transition, unroll_length: int) -> Transition:
    """From [T, N, ...] to [T / unroll_length * N, unroll_length, ...], as Brax's loss takes it.

    Of the next observations only the last of each unroll is kept, [.., 1, ...]: the loss reads no other.
    """

    def cut(x: jax.Array) -> jax.Array:
        unrolls = x.reshape((-1, unroll_length, *x.shape[1:])).swapaxes(1, 2)
        return unrolls.reshape((-1, unroll_length, *x.shape[2:]))

    batch: Transition = jax.tree.map(cut, transitions)
    return batch._replace(next_observation=batch.next_observation[:, -1:])


def summarise(outcome: Outcome) -> dict[str, jax.Array]:
    """Sums over one update, [] float32: finished episodes, their scores and lengths, and the mean speed."""
    sums = {
        "episodes": jnp.sum(outcome.ended_length > 0).astype(jnp.float32),
        "score": jnp.sum(outcome.ended_score),
        "length": jnp.sum(outcome.ended_length).astype(jnp.float32),
    }
    return sums if outcome.x_velocity is None else sums | {"forward_speed": jnp.mean(outcome.x_velocity)}
