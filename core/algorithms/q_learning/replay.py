"""Experience replay: the newest transitions, to learn from again.

Source: Lin, Self-improving reactive agents based on reinforcement learning, planning and teaching (1992).
"""

import jax
import jax.numpy as jnp
from flax import struct

from core.algorithms.q_learning.table import Transitions


@struct.dataclass
class TransitionReplay:
    """A ring of transitions [buffer_size]. count: [] int32, how many it holds; head: [] int32, where the next
    one goes."""

    steps: Transitions
    count: jax.Array
    head: jax.Array


def empty(buffer_size: int) -> TransitionReplay:
    """A buffer without a transition."""
    index, number = jnp.zeros(buffer_size, jnp.int32), jnp.zeros(buffer_size)
    steps = Transitions(index, index, number, index, number, number)
    return TransitionReplay(steps, jnp.int32(0), jnp.int32(0))


def add(replay: TransitionReplay, steps: Transitions) -> TransitionReplay:
    """The buffer with these transitions [N] instead of its oldest; of too many, with the last of them."""
    size = len(replay.steps.row)
    newest = jax.tree.map(lambda x: x[-size:], steps)
    num = len(newest.row)
    places = (replay.head + jnp.arange(num)) % size
    return TransitionReplay(
        steps=jax.tree.map(lambda kept, new: kept.at[places].set(new), replay.steps, newest),
        count=jnp.minimum(replay.count + num, size),
        head=(replay.head + num) % size,
    )


def draw(replay: TransitionReplay, key: jax.Array, batch_size: int) -> Transitions:
    """[batch_size] of the transitions that it holds, each any of them; of weight 0 where it holds none."""
    chosen = jax.random.randint(key, (batch_size,), 0, jnp.maximum(replay.count, 1))
    return jax.tree.map(lambda x: x[chosen], replay.steps)
