"""Many episodes side by side: truncation by length, and a fresh start where one has ended."""

from dataclasses import replace
from typing import TypeVar

import jax
import jax.numpy as jnp
from flax import struct

from core.environments.environment import Environment, State

Tree = TypeVar("Tree")


@struct.dataclass
class Episodes:
    """`num_envs` environments, each somewhere in an episode.

    state: after the last step, already set back to the first one where an episode ended; its `done`
    says so (1 for a termination or a truncation). first: every environment's own first state.
    truncated: [num_envs], 1 where the last step cut an episode off that had not terminated.
    length: [num_envs] int32, actions taken in the running episode. score: [num_envs], rewards summed
    over it. ended_length, ended_score: [num_envs], those of the episode that the last step ended, and
    0 elsewhere.
    """

    state: State
    first: State
    truncated: jax.Array
    length: jax.Array
    score: jax.Array
    ended_length: jax.Array
    ended_score: jax.Array


def start_episodes(environment: Environment, key: jax.Array, num_envs: int) -> Episodes:
    """`num_envs` fresh episodes."""
    state = jax.vmap(environment.reset)(jax.random.split(key, num_envs))
    zeros = jnp.zeros(num_envs)
    count = jnp.zeros(num_envs, jnp.int32)
    return Episodes(
        state=state,
        first=state,
        truncated=zeros,
        length=count,
        score=zeros,
        ended_length=count,
        ended_score=zeros,
    )


def step_episodes(
    environment: Environment, episodes: Episodes, action: jax.Array, *, episode_length: int
) -> Episodes:
    """Every episode one action [num_envs, action_size] later.

    Where one ends, physics, observation and info go back to that environment's own first state, as in
    Brax: a reset in every step would cost as much as the step. Reward, done and metrics stay those of
    the step.
    """
    state = jax.vmap(environment.step)(episodes.state, action)
    length = episodes.length + 1
    score = episodes.score + state.reward
    cut_off = jnp.where(length >= episode_length, 1.0, 0.0)
    done = jnp.maximum(state.done, cut_off)
    ended = done > 0
    first = episodes.first
    restarted = replace(
        state,
        physics=select(ended, first.physics, state.physics),
        obs=select(ended, first.obs, state.obs),
        info=select(ended, first.info, state.info),
        done=done,
    )
    return Episodes(
        state=restarted,
        first=first,
        truncated=cut_off * (1 - state.done),
        length=jnp.where(ended, 0, length),
        score=jnp.where(ended, 0.0, score),
        ended_length=jnp.where(ended, length, 0),
        ended_score=jnp.where(ended, score, 0.0),
    )


def select(condition: jax.Array, yes: Tree, no: Tree) -> Tree:
    """`yes` where the condition [num_envs] holds and `no` elsewhere, for every array of two equal trees."""

    def choose(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.where(condition.reshape(condition.shape + (1,) * (a.ndim - 1)), a, b)

    return jax.tree.map(choose, yes, no)
