"""The last transitions of all environments, and samples of several steps of them.

Next observations are not stored: that of a transition is the observation of its environment's next row,
unless the episode ended there.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int


@struct.dataclass
class ReplayRows:
    """A row for each action of all environments, [rows, num_envs, ...].

    ended: 1 where the environment ended the episode; truncated: 1 where its length did.
    """

    observation: Float[Array, "rows N obs"]
    action: Float[Array, "rows N act"]
    reward: Float[Array, "rows N"]
    ended: Float[Array, "rows N"]
    truncated: Float[Array, "rows N"]


@struct.dataclass
class Replay:
    """A ring of rows. written: [] int32, rows since the beginning; the oldest are overwritten."""

    rows: ReplayRows
    written: Int[Array, ""]

    @property
    def capacity(self) -> int:
        return self.rows.reward.shape[0]


class Sample(NamedTuple):
    """B starts of up to n steps each.

    reward: [B], the discounted sum. discount: [B], the weight of what follows at `next_observation`; 0 where
    the episode ended. weight: [B], 0 where there is nothing to learn from.
    """

    observation: Float[Array, "B obs"]
    action: Float[Array, "B act"]
    reward: Float[Array, " B"]
    discount: Float[Array, " B"]
    next_observation: Float[Array, "B obs"]
    weight: Float[Array, " B"]


def empty(num_rows: int, num_envs: int, observation_size: int, action_size: int) -> Replay:
    """Room for `num_rows` actions of each environment."""
    zeros = jnp.zeros((num_rows, num_envs))
    rows = ReplayRows(
        observation=jnp.zeros((num_rows, num_envs, observation_size)),
        action=jnp.zeros((num_rows, num_envs, action_size)),
        reward=zeros,
        ended=zeros,
        truncated=zeros,
    )
    return Replay(rows, jnp.int32(0))


def added(replay: Replay, rows: ReplayRows) -> Replay:
    """The replay after T more rows [T, N, ...]; T is the capacity at most."""
    places = (replay.written + jnp.arange(len(rows.reward))) % replay.capacity
    kept = jax.tree.map(lambda old, new: old.at[places].set(new), replay.rows, rows)
    return Replay(kept, replay.written + len(rows.reward))


def sample(replay: Replay, key: jax.Array, batch_size: int, *, n_step: int, discounting: jax.Array) -> Sample:
    """Starts drawn uniformly from those whose n steps, and the row after them, are there.

    A step that cuts an episode off is left out, because the state it led to is gone: the sum ends before it,
    and what follows is estimated at its own observation.
    """
    row_key, env_key = jax.random.split(key)
    oldest = jnp.maximum(replay.written - replay.capacity, 0)
    first = jax.random.randint(
        row_key, (batch_size,), oldest, jnp.maximum(replay.written - n_step, oldest + 1)
    )
    env = jax.random.randint(env_key, (batch_size,), 0, replay.rows.reward.shape[1])

    def row(offset: int | jax.Array) -> jax.Array:
        return (first + offset) % replay.capacity

    goes_on, total, weight = jnp.ones(batch_size), jnp.zeros(batch_size), jnp.ones(batch_size)
    length = jnp.full(batch_size, n_step, jnp.int32)
    ended = jnp.zeros(batch_size)
    for k in range(n_step):
        reward, ends, cut = (
            of[row(k), env] for of in (replay.rows.reward, replay.rows.ended, replay.rows.truncated)
        )
        length = jnp.where((goes_on > 0) & (cut > 0), k, length)
        goes_on *= 1 - cut
        total += goes_on * weight * reward
        ended = jnp.maximum(ended, goes_on * ends)
        goes_on *= 1 - ends
        weight = weight * discounting
    return Sample(
        observation=replay.rows.observation[row(0), env],
        action=replay.rows.action[row(0), env],
        reward=total,
        discount=(1 - ended) * discounting**length,
        next_observation=replay.rows.observation[row(length), env],
        weight=(length > 0).astype(jnp.float32),
    )
