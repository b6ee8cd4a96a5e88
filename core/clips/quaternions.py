"""Turns as unit quaternions w x y z. NumPy alone."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def conjugate(quaternions: Array) -> Array:
    """The inverse turns. [..., 4]"""
    return quaternions * np.array([1.0, -1.0, -1.0, -1.0])


def multiply(first: Array, second: Array) -> Array:
    """Hamilton's product: the turn `second`, and then `first`. [..., 4]"""
    w1, x1, y1, z1 = np.moveaxis(first, -1, 0)
    w2, x2, y2, z2 = np.moveaxis(second, -1, 0)
    return np.stack(
        [
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ],
        axis=-1,
    )


def rotation_vector(quaternions: Array) -> Array:
    """Axis times angle in [0, π] of unit quaternions; q and -q are the same turn. [..., 4] to [..., 3]"""
    positive = np.where(quaternions[..., :1] < 0, -quaternions, quaternions)
    axis = positive[..., 1:]
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, positive[..., :1])
    # Of a small turn, angle / sine is 2 to the precision of float64.
    return axis * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 2.0)


def from_rotation_vector(vectors: Array) -> Array:
    """Unit quaternions of axis times angle. [..., 3] to [..., 4]"""
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    # np.sinc is that of signal processing, sin(πx) / πx.
    return np.concatenate([np.cos(angle / 2), vectors / 2 * np.sinc(angle / (2 * np.pi))], axis=-1)


def slerp(first: Array, second: Array, share: Array) -> Array:
    """The turn that is this share of the shorter way from the first to the second.

    first, second: [..., 4]. share: [..., 1], 0 to 1.
    """
    way = rotation_vector(multiply(conjugate(first), second))
    return multiply(first, from_rotation_vector(way * share))
