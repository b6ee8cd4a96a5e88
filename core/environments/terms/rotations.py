"""Turns as unit quaternions w x y z, [..., 4], in the array library of a step."""

from types import ModuleType

from core.environments.terms.term import Array


def conjugate(turn: Array, xp: ModuleType) -> Array:
    """The turn back."""
    return xp.concatenate([turn[..., :1], -turn[..., 1:]], -1)


def product(one: Array, other: Array, xp: ModuleType) -> Array:
    """The turn that is as the other one, and then as the first."""
    w, v, s, u = one[..., :1], one[..., 1:], other[..., :1], other[..., 1:]
    real = w * s - xp.sum(v * u, -1, keepdims=True)
    return xp.concatenate([real, w * u + s * v + xp.cross(v, u)], -1)


def rotated(turn: Array, vector: Array, xp: ModuleType) -> Array:
    """The vectors [..., 3], turned."""
    w, v = turn[..., :1], turn[..., 1:]
    return vector + 2.0 * xp.cross(v, xp.cross(v, vector) + w * vector)


def angle_between(one: Array, other: Array, xp: ModuleType) -> Array:
    """The angle of the turn from one to the other, [...] in rad, from 0 to π."""
    way = product(conjugate(one, xp), other, xp)
    sine = xp.sqrt(xp.sum(way[..., 1:] ** 2, -1))
    return 2.0 * xp.arctan2(sine, abs(way[..., 0]))


def heading(turn: Array, xp: ModuleType) -> Array:
    """Its part about the world's z: the turn [..., 4] that heads the same way and keeps what is upright."""
    w, x, y, z = (turn[..., part] for part in range(4))
    half = 0.5 * xp.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    zero = xp.zeros_like(half)
    return xp.stack([xp.cos(half), zero, zero, xp.sin(half)], -1)


def two_axes(turn: Array, xp: ModuleType) -> Array:
    """Where it turns x and y to, [..., 6]: unlike a quaternion, near for turns that are near.

    Source: Zhou et al., On the Continuity of Rotation Representations in Neural Networks (2019).
    """
    w, x, y, z = (turn[..., part] for part in range(4))
    return xp.stack(
        [
            1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
            2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        ],
        -1,
    )  # fmt: skip
