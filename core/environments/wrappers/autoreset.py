"""Many episodes side by side: their end, by length or with a lost body, and a fresh start after it.

An engine lost a body's state if it returned values that are not finite, or ran out of room for contacts.
MuJoCo Playground's environments end such an episode, too (`done |= jnp.isnan(data.qpos).any()`).
"""

from dataclasses import replace
from typing import TypeVar

import jax
import jax.numpy as jnp
from flax import struct

from core.environments.environment import TRUNCATED, State, terminated
from core.environments.wrappers.terrain_levels import cells_of_pool, first_cells
from core.environments.wrappers.vectorized import VectorEnv

Tree = TypeVar("Tree")


@struct.dataclass
class Episodes:
    """`num_envs` environments, each somewhere in an episode.

    state: after the last step, already a fresh start where an episode ended; `done` is 1 there, after a
    termination or a truncation. first: every environment's own first state, if it returns to that; None if
    fresh starts come from a pool. truncated: [num_envs], 1 where the last step cut an episode off that had
    not terminated, by its length or because its task was over. length: [num_envs] int32, actions taken in the
    running episode. score: [num_envs], rewards summed over it. ended_length, ended_score: [num_envs], those
    of the episode that the last step ended, and 0 elsewhere.
    """

    state: State
    first: State | None
    truncated: jax.Array
    length: jax.Array
    score: jax.Array
    ended_length: jax.Array
    ended_score: jax.Array


def start_episodes(envs: VectorEnv, key: jax.Array, num_envs: int, *, keep_first: bool = False) -> Episodes:
    """`num_envs` fresh episodes; keep_first: remember their first states, to return to them."""
    state = fresh_states(envs, key, num_envs, first_cells(envs.environment, key, num_envs))
    zeros = jnp.zeros(num_envs)
    count = jnp.zeros(num_envs, jnp.int32)
    return Episodes(
        state=state,
        first=state if keep_first else None,
        truncated=zeros,
        length=count,
        score=zeros,
        ended_length=count,
        ended_score=zeros,
    )


def begun_at_random(episodes: Episodes, key: jax.Array, *, episode_length: int) -> Episodes:
    """The same episodes, as if each had already run for a random number of actions below `episode_length`.

    Their ends are then spread over time from the start.
    Source: `init_at_random_ep_len` of RSL-RL (Rudin et al., Learning to Walk in Minutes, 2022).
    """
    length = jax.random.randint(key, episodes.length.shape, 0, episode_length, jnp.int32)
    return replace(episodes, length=length)


def fresh_states(envs: VectorEnv, key: jax.Array, num_states: int, cells: jax.Array | None = None) -> State:
    """Initial states [num_states, ...], each from its own key. cells: of a terrain; None: any."""
    return envs.reset(jax.random.split(key, num_states), cells)


def fresh_pool(envs: VectorEnv, key: jax.Array, size: int) -> State:
    """Initial states [size, ...]; a few more where a terrain's levels need it, to have as many of each."""
    cells = cells_of_pool(envs.environment, size)
    return fresh_states(envs, key, size if cells is None else len(cells), cells)


def draw(pool: State, chosen: jax.Array) -> State:
    """The states [num_envs, ...] of a pool with the indices `chosen` [num_envs]."""
    return jax.tree.map(lambda x: jnp.take(x, chosen, axis=0, mode="clip"), pool)


def follow(episodes: Episodes, state: State, starts: State | None, *, episode_length: int) -> Episodes:
    """The episodes after a step that led to `state` [num_envs, ...].

    Where one ends, physics, observation and info become those of `starts` [num_envs, ...], because a reset in
    every step would cost as much as the step. None: those of the environment's own first state, as in Brax;
    raises ValueError if these were not kept. Reward, done and metrics stay those of the step.
    """
    fresh = episodes.first if starts is None else starts
    if fresh is None:
        raise ValueError("There are no states to restart from: give `starts`, or keep the first states.")
    length = episodes.length + 1
    score = episodes.score + state.reward
    cut_off = jnp.where(length >= episode_length, 1.0, 0.0)
    done = jnp.maximum(state.done, cut_off)
    if TRUNCATED in state.info:
        cut_off = jnp.maximum(cut_off, state.info[TRUNCATED])
    ended = done > 0
    restarted = replace(
        state,
        physics=select(ended, fresh.physics, state.physics),
        obs=select(ended, fresh.obs, state.obs),
        info=select(ended, fresh.info, state.info),
        done=done,
    )
    return Episodes(
        state=restarted,
        first=episodes.first,
        truncated=cut_off * (1 - terminated(state)),
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


def without_lost(before: State, after: State) -> tuple[State, jax.Array]:
    """`after` [N, ...] a step, and which bodies it lost, [N] bool.

    A lost body keeps the state before the step, its episode ends, and its reward and metrics are 0. A
    reward that is not finite though the body's state is: that is the task's error, and it stays.
    """
    lost = ~_is_finite(after)
    at_rest = replace(
        after,
        physics=before.physics,
        obs=before.obs,
        info=before.info,
        reward=jnp.zeros_like(after.reward),
        done=jnp.ones_like(after.done),
        metrics=jax.tree.map(jnp.zeros_like, after.metrics),
    )
    return select(lost, at_rest, after), lost


def _is_finite(state: State) -> jax.Array:
    """[N] bool: whether positions, velocities and all that is observed are."""
    seen = [state.physics.qpos, state.physics.qvel, *jax.tree.leaves(state.obs)]
    return jnp.stack([jnp.isfinite(x).all(axis=tuple(range(1, x.ndim))) for x in seen]).all(axis=0)
