"""The network of a star of arms: each has an oscillator in the plane and one out of it.

Oscillator 2k moves arm k in the plane and 2k + 1 out of it. The two of an arm are coupled, and so are
oscillators of the same kind in neighbouring arms, all around.
"""

import jax
import numpy as np
from numpy.typing import NDArray

FEWEST_ARMS = 3


def num_oscillators(num_arms: int) -> int:
    return 2 * num_arms


def edges(num_arms: int) -> NDArray[np.intp]:
    """[3 num_arms, 2]: the couplings. First within each arm, in the plane to out of it; then from each arm to
    the next one, in the plane; then the same out of it.

    Raises ValueError for too few arms to form a ring.
    """
    if num_arms < FEWEST_ARMS:
        raise ValueError(f"A star needs at least {FEWEST_ARMS} arms, not {num_arms}.")
    arm = np.arange(num_arms)
    following = np.roll(arm, -1)
    within, in_plane, out_of_plane = (
        (2 * arm, 2 * arm + 1),
        (2 * arm, 2 * following),
        (2 * arm + 1, 2 * following + 1),
    )
    return np.concatenate([np.stack(pair, axis=1) for pair in (within, in_plane, out_of_plane)])


def weights(num_arms: int, weight: float) -> NDArray[np.float32]:
    """[n, n]: `weight` where two oscillators are coupled, both ways, and 0 elsewhere."""
    tail, head = edges(num_arms).T
    matrix = np.zeros((num_oscillators(num_arms),) * 2, np.float32)
    matrix[tail, head] = matrix[head, tail] = weight
    return matrix


def between_all(biases: jax.Array) -> jax.Array:
    """[..., n, n]: by how much j is ahead of i, from these along the edges [..., 3 num_arms]; elsewhere 0."""
    num_arms = biases.shape[-1] // 3
    tail, head = edges(num_arms).T
    edge, sign = np.zeros((2, *(num_oscillators(num_arms),) * 2), np.int32)
    edge[tail, head] = edge[head, tail] = np.arange(len(tail))
    sign[tail, head], sign[head, tail] = 1, -1
    return biases[..., edge] * sign.astype(np.float32)


def along_edges(matrix: jax.Array) -> jax.Array:
    """[..., 3 num_arms]: the entries of [..., n, n] that belong to the edges."""
    tail, head = edges(matrix.shape[-1] // 2).T
    return matrix[..., tail, head]
