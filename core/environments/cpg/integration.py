"""Steps in time. Both solve the coupled system: each slope is that of the whole state."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp

from core.environments.cpg.oscillators import Modulation, Network, Oscillators, derivative

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
    network: Network,
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
