"""Amplitude-controlled phase oscillators: their input, their dynamics and their output.

Source: Ijspeert, Crespi, Ryczko & Cabelguen, From swimming to walking with a salamander robot driven by a
spinal cord model (Science, 2007), supporting material; Sproewitz, Moeckel, Maye & Ijspeert, Learning to move
in modular robots using central pattern generators and online optimization (2008), section 3.

Every function takes leading batch axes, written [...]; n is the number of oscillators. Angles are in rad,
rates per second; amplitudes and offsets are in the unit of the output.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
from flax import struct


@struct.dataclass
class Oscillators:
    """The state of n oscillators; all fields [..., n].

    It also serves as their time derivative, which has the same fields.
    """

    phases: jax.Array
    amplitudes: jax.Array
    amplitude_rates: jax.Array
    offsets: jax.Array
    offset_rates: jax.Array


@struct.dataclass
class Modulation:
    """The values that a controller sets and the oscillators then tend to.

    amplitudes (R of the paper), offsets (X): [..., n]. frequencies (ω): [..., n] in rad/s, or [..., 1] for
    one that all share. phase_biases (φ_ij): [..., n, n], by how much j should be ahead of i; read only where
    i and j are coupled, and reachable only if antisymmetric.
    """

    amplitudes: jax.Array
    offsets: jax.Array
    frequencies: jax.Array
    phase_biases: jax.Array


@struct.dataclass
class OscillatorNetwork:
    """The constants. weights (w_ij): [n, n], how strongly i follows j, per second and unit of j's amplitude.
    The gains (a_i) are twice the rate, in 1/s, at which amplitudes and offsets settle."""

    weights: jax.Array
    amplitude_gain: float
    offset_gain: float


def at_rest(phases: jax.Array) -> Oscillators:
    """Oscillators with these phases [..., n] and no amplitude yet."""
    zeros = jnp.zeros_like(phases)
    return Oscillators(phases, zeros, zeros, zeros, zeros)


def derivative(network: OscillatorNetwork, modulation: Modulation, now: Oscillators) -> Oscillators:
    """The time derivative of the whole state.

    φ'_i = ω_i + Σ_j w_ij r_j sin(φ_j - φ_i - φ_ij);  r''_i = a (a/4 (R_i - r_i) - r'_i);  the offset like r.
    Source: Sproewitz et al. (2008), eq. 1-3.
    """
    ahead = now.phases[..., None, :] - now.phases[..., :, None] - modulation.phase_biases
    pull = network.weights * now.amplitudes[..., None, :] * jnp.sin(ahead)
    return Oscillators(
        phases=modulation.frequencies + jnp.sum(pull, axis=-1),
        amplitudes=now.amplitude_rates,
        amplitude_rates=_towards(
            modulation.amplitudes, network.amplitude_gain, now.amplitudes, now.amplitude_rates
        ),
        offsets=now.offset_rates,
        offset_rates=_towards(modulation.offsets, network.offset_gain, now.offsets, now.offset_rates),
    )


def output(now: Oscillators) -> jax.Array:
    """[..., n]: x + r cos φ. Source: Sproewitz et al. (2008), eq. 4."""
    return now.offsets + now.amplitudes * jnp.cos(now.phases)


def _towards(target: jax.Array, gain: float, value: jax.Array, rate: jax.Array) -> jax.Array:
    """The acceleration of a critically damped approach."""
    return gain * (gain / 4 * (target - value) - rate)


Integrator = Literal["euler", "rk4"]
Slope = Callable[[Oscillators], Oscillators]


def euler(slope: Slope, now: Oscillators, dt: float) -> Oscillators:
    """dt seconds later, of order 1."""
    return _along(now, slope(now), dt)


def rk4(slope: Slope, now: Oscillators, dt: float) -> Oscillators:
    """dt seconds later, of order 4: the classical method of Runge and Kutta."""
    first = slope(now)
    second = slope(_along(now, first, dt / 2))
    third = slope(_along(now, second, dt / 2))
    fourth = slope(_along(now, third, dt))
    mean = jax.tree.map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, first, second, third, fourth)
    return _along(now, mean, dt)


_STEPS = {"euler": euler, "rk4": rk4}


def advance(
    network: OscillatorNetwork,
    modulation: Modulation,
    now: Oscillators,
    dt: float,
    integrator: Integrator = "rk4",
    num_steps: int = 1,
) -> Oscillators:
    """The oscillators after dt seconds under one modulation, in num_steps equal steps.

    Phases are wrapped to [0, 2π), because in float32 a phase that grows for ever loses precision.
    """

    def step(now: Oscillators, _: None) -> tuple[Oscillators, None]:
        return _STEPS[integrator](partial(derivative, network, modulation), now, dt / num_steps), None

    after = jax.lax.scan(step, now, length=num_steps)[0] if num_steps > 1 else step(now, None)[0]
    return replace(after, phases=jnp.mod(after.phases, 2 * jnp.pi))


def _along(now: Oscillators, slope: Oscillators, dt: float) -> Oscillators:
    return jax.tree.map(lambda value, rate: value + dt * rate, now, slope)
