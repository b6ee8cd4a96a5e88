"""Rowing: what each arm of a star does for the star to move in the direction of one of them.

The leading arm is held up. The arms beside it row: they sweep in the plane, and some part of a period later
move up and down, so that they sweep back on the ground and forward above it, both sides in step. With an even
number of arms, the one opposite the leading one trails: it moves up and down with the others, but does not
sweep. That passes the rhythm from one side to the other; if it stood still, nothing would, and the star would
walk in a curve.

Source: the leading-arm modulation of the tutorial notebook for five arms, here for any number and by roles.
The bias between two oscillators depends only on the roles of their arms, so arms that choose their own roles
row as well as arms whose roles are set together.

Each arm has an oscillator in the plane and one out of it: 2k moves arm k in the plane and 2k + 1 out of it.
The two of an arm are coupled, and so are oscillators of the same kind in neighbouring arms, all around.
"""

import dataclasses
from enum import IntEnum
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from numpy.typing import NDArray

from core.environments.cpg.oscillators import Modulation

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


class Role(IntEnum):
    """The role of an arm. Left and right are as seen from above, in the direction of the walk; arms are
    numbered counter-clockwise. The notebook swaps the two names."""

    LEADING = 0
    LEFT = 1
    RIGHT = 2
    TRAILING = 3


def roles_for(num_arms: int) -> tuple[Role, ...]:
    """The roles in a star of `num_arms` arms: with an odd number, no arm trails."""
    return tuple(Role)[: 3 + (num_arms % 2 == 0)]


@struct.dataclass
class Gait:
    """How arms row. frequency: in rad/s. In the unit of the output, sweep: the amplitude in the plane,
    stroke: that out of it, lift: how far the leading arm is held up. lag: of the stroke behind the sweep, in
    rad; the notebook's is a quarter of a period."""

    frequency: float
    sweep: float
    stroke: float
    lift: float
    lag: float = np.pi / 2


# For each role: whether the arm moves in the plane, whether it moves out of it, and whether it is held up.
_SWEEPS = np.array([0, 1, 1, 0], np.float32)
_STROKES = np.array([0, 1, 1, 1], np.float32)
_IS_UP = np.array([1, 0, 0, 0], np.float32)


def _between(**ahead: float) -> NDArray[np.float32]:
    """[4, 4], antisymmetric: by how much the second role is ahead of the first."""
    table = np.zeros((len(Role),) * 2, np.float32)
    for pair, bias in ahead.items():
        first, second = (Role[name.upper()] for name in pair.split("_"))
        table[first, second], table[second, first] = bias, -bias
    return table


# Rowing arms have consistent biases, so they lock in any combination. The leading arm's own amplitude is 0,
# so no arm follows it, and its biases matter only while its amplitude falls; they are the notebook's.
_IN_PLANE = _between(right_left=np.pi, right_leading=np.pi / 4, leading_left=np.pi / 4)
_OUT_OF_PLANE = _between(leading_right=np.pi / 4, left_leading=np.pi / 4)


def roles_under(leading_arm: jax.Array | int, num_arms: int) -> jax.Array:
    """[..., num_arms] int32: what each arm does where `leading_arm` [...] leads.

    Half of the others are on each side; if their number is odd, the arm opposite the leading one is
    TRAILING.
    """
    steps = np.arange(num_arms)
    # Indexed by the number of arms after the leading one.
    table = np.where(2 * steps < num_arms, Role.LEFT, Role.RIGHT)
    table = np.where(2 * steps == num_arms, Role.TRAILING, table)
    table[0] = Role.LEADING
    behind = (steps - jnp.asarray(leading_arm)[..., None]) % num_arms
    return jnp.asarray(table, jnp.int32)[behind]


def modulation(roles: jax.Array, gait: Gait) -> Modulation:
    """The modulation for arms in any roles [..., num_arms]."""
    in_plane, out_of_plane, offset = (jnp.asarray(table)[roles] for table in (_SWEEPS, _STROKES, _IS_UP))
    zeros = jnp.zeros_like(in_plane)
    return Modulation(
        amplitudes=_alternating(gait.sweep * in_plane, gait.stroke * out_of_plane),
        offsets=_alternating(zeros, gait.lift * offset),
        frequencies=jnp.broadcast_to(jnp.asarray(gait.frequency)[..., None], (*roles.shape[:-1], 1)),
        phase_biases=between_all(_biases(roles, gait.lag)),
    )


def strengths(factors: jax.Array, gait: Gait) -> Modulation:
    """The modulation for arms that all row in one sense, each as far as its factor [..., num_arms] says.

    Every arm pushes the star across itself, in the sense of an arm on the left. So arms to one side of a
    direction bring the star there while it turns.
    """
    rowing = modulation(jnp.full(factors.shape, Role.LEFT, jnp.int32), gait)
    return dataclasses.replace(rowing, amplitudes=jnp.repeat(factors, 2, axis=-1) * rowing.amplitudes)


def _biases(roles: jax.Array, lag: jax.Array | float) -> jax.Array:
    """Phase biases [..., 3 num_arms], in the order of the edges."""
    # The right side sweeps half a period from the left, and strokes in step with it.
    left, right = (roles == role for role in (Role.LEFT, Role.RIGHT))
    within = jnp.where(left, -lag, jnp.where(right, np.pi - lag, 0.0))
    following = jnp.roll(roles, -1, axis=-1)
    tables = jnp.asarray(_IN_PLANE)[roles, following], jnp.asarray(_OUT_OF_PLANE)[roles, following]
    return jnp.concatenate([within, *tables], axis=-1)


def _alternating(in_plane: jax.Array, out_of_plane: jax.Array) -> jax.Array:
    """[..., 2 num_arms] in the order of the oscillators, from [..., num_arms] each."""
    return jnp.stack([in_plane, out_of_plane], axis=-1).reshape(*in_plane.shape[:-1], -1)


class Bounds(Protocol):
    """The meaning of an action's ends: amplitudes lie in [0, max_amplitude], offsets in ± max_offset, both in
    the unit of the output, and the frequency that all oscillators share in [0, max_frequency] rad/s."""

    @property
    def max_amplitude(self) -> float: ...

    @property
    def max_offset(self) -> float: ...

    @property
    def max_frequency(self) -> float: ...


def action_size(num_arms: int) -> int:
    return 7 * num_arms + 1


def encode(modulation: Modulation, bounds: Bounds) -> jax.Array:
    """The action [..., 7 num_arms + 1] that `decode` takes for this modulation of one shared frequency."""
    return jnp.concatenate(
        [
            modulation.amplitudes / bounds.max_amplitude * 2 - 1,
            modulation.offsets / bounds.max_offset,
            along_edges(modulation.phase_biases) / jnp.pi,
            modulation.frequencies[..., :1] / bounds.max_frequency * 2 - 1,
        ],
        axis=-1,
    )


def decode(action: jax.Array, bounds: Bounds) -> Modulation:
    """The modulation that an action [..., 7 num_arms + 1] stands for."""
    n = 2 * ((action.shape[-1] - 1) // 7)
    amplitudes, offsets, biases, frequency = jnp.split(action, [n, 2 * n, action.shape[-1] - 1], axis=-1)
    return Modulation(
        amplitudes=(amplitudes + 1) / 2 * bounds.max_amplitude,
        offsets=offsets * bounds.max_offset,
        frequencies=(frequency + 1) / 2 * bounds.max_frequency,
        phase_biases=between_all(biases * jnp.pi),
    )
