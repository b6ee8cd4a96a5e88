"""Oscillators against what can be computed by hand."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.typing import NDArray

from core.environments.cpg.oscillators import (
    Integrator,
    Modulation,
    OscillatorNetwork,
    Oscillators,
    advance,
    at_rest,
    output,
)

GAIN = 4.0
WEIGHT = 1.5
BIAS = 0.5
BEGIN = 2.0  # by how much the second of a pair is ahead at first
advance = jax.jit(advance, static_argnames=("integrator", "num_steps"))
PAIR = OscillatorNetwork(jnp.array([[0.0, WEIGHT], [WEIGHT, 0.0]]), GAIN, GAIN)


def towards(
    amplitude: float = 1.0, offset: float = 0.0, frequencies: tuple[float, ...] = (3.0,)
) -> Modulation:
    """For a pair, of which the second shall be ahead by BIAS."""
    return Modulation(
        amplitudes=jnp.full(2, amplitude),
        offsets=jnp.full(2, offset),
        frequencies=jnp.array(frequencies),
        phase_biases=jnp.array([[0.0, BIAS], [-BIAS, 0.0]]),
    )


def a_pair(amplitude: float = 0.0) -> Oscillators:
    return replace(at_rest(jnp.array([0.0, BEGIN])), amplitudes=jnp.full(2, amplitude))


def ahead(now: Oscillators) -> jax.Array:
    """By how much the second is, in (-π, π]."""
    difference = now.phases[1] - now.phases[0]
    return jnp.arctan2(jnp.sin(difference), jnp.cos(difference))


def decayed(exponent: float) -> float:
    """Of d' = -2 w r sin(d - BIAS): tan((d - BIAS) / 2) falls by exp(-2 w ∫ r dt), whose exponent this is."""
    return BIAS + 2 * np.arctan(np.tan((BEGIN - BIAS) / 2) * np.exp(-exponent))


def settled(time: float | NDArray[np.float64]) -> NDArray[np.float64]:
    """A critically damped approach to 1 from rest at 0."""
    return np.asarray(1 - (1 + GAIN * time / 2) * np.exp(-GAIN * time / 2))


@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_a_lone_oscillator_turns_with_its_frequency(integrator: Integrator) -> None:
    alone = OscillatorNetwork(jnp.zeros((1, 1)), GAIN, GAIN)
    wanted = Modulation(jnp.ones(1), jnp.ones(1), jnp.array([2 * np.pi * 0.7]), jnp.zeros((1, 1)))
    after = advance(alone, wanted, at_rest(jnp.array([0.3])), 3.0, integrator, num_steps=30)
    np.testing.assert_allclose(after.phases, [(0.3 + 2 * np.pi * 0.7 * 3.0) % (2 * np.pi)], atol=1e-4)


def test_amplitudes_and_offsets_settle_without_overshooting() -> None:
    for seconds in (0.1, 0.5, 1.0, 3.0):
        after = advance(PAIR, towards(0.8, -0.3), at_rest(jnp.zeros(2)), seconds, num_steps=50)
        np.testing.assert_allclose(after.amplitudes, np.full(2, 0.8 * settled(seconds)), atol=1e-5)
        np.testing.assert_allclose(after.offsets, np.full(2, -0.3 * settled(seconds)), atol=1e-5)


def test_phases_lock_at_the_bias_as_fast_as_the_coupling_says() -> None:
    for seconds in (0.2, 0.5, 1.0, 4.0):
        after = advance(PAIR, towards(), a_pair(amplitude=1.0), seconds, num_steps=80)
        # The amplitude stays 1, so ∫ r dt is the time.
        np.testing.assert_allclose(ahead(after), decayed(2 * WEIGHT * seconds), atol=2e-5)


def test_unlike_frequencies_lock_beside_the_bias() -> None:
    # d' = 0.6 - 2 w sin(d - BIAS) = 0 at sin(d - BIAS) = 0.6 / (2 · 1.5) = 0.2.
    after = advance(PAIR, towards(frequencies=(3.0, 3.6)), a_pair(amplitude=1.0), 8.0, num_steps=400)
    np.testing.assert_allclose(ahead(after), BIAS + np.arcsin(0.2), atol=1e-4)


def test_who_has_no_amplitude_is_followed_by_nobody() -> None:
    wanted = replace(towards(), amplitudes=jnp.array([1.0, 0.0]))
    silent = replace(a_pair(), amplitudes=jnp.array([1.0, 0.0]))
    after = advance(PAIR, wanted, silent, 0.5, num_steps=20)
    np.testing.assert_allclose(after.phases[0], 1.5, atol=1e-5)  # 3 rad/s, undisturbed
    np.testing.assert_allclose(ahead(after), decayed(WEIGHT * 0.5), atol=1e-4)  # one pulls instead of two


@pytest.mark.parametrize(("integrator", "order", "num_steps"), [("euler", 1, 64), ("rk4", 4, 16)])
def test_halving_the_step_divides_the_error_of_the_coupled_system_by_two_to_the_order(
    integrator: Integrator, order: int, num_steps: int
) -> None:
    # The amplitudes grow while they pull the phases: ∫ r dt = t - 4/γ + (4/γ + t) exp(-γ t / 2).
    seconds = 1.0
    grown = seconds - 4 / GAIN + (4 / GAIN + seconds) * np.exp(-GAIN * seconds / 2)
    exact = np.array([decayed(2 * WEIGHT * grown), settled(seconds)])

    def error(num_steps: int) -> NDArray[np.float64]:
        now = advance(PAIR, towards(), a_pair(), seconds, integrator, num_steps)
        return np.abs(np.array([ahead(now), now.amplitudes[0]]) - exact)

    with jax.enable_x64(True):
        np.testing.assert_allclose(np.log2(error(num_steps) / error(2 * num_steps)), order, atol=0.2)


def test_the_output_swings_about_the_offset() -> None:
    now = replace(
        at_rest(jnp.array([0.0, np.pi / 3])), amplitudes=jnp.array([2.0, 4.0]), offsets=jnp.array([1.0, -1.0])
    )
    np.testing.assert_allclose(output(now), [1 + 2, -1 + 4 * 0.5], rtol=1e-6)


def test_a_batch_is_what_its_members_are_alone() -> None:
    keys = jax.random.split(jax.random.key(0), 3)
    many = jax.vmap(lambda key: Oscillators(*jax.random.normal(key, (5, 2))))(keys)
    wanted = jax.tree.map(lambda x: jnp.stack([x, 2 * x, -x]), towards())
    together = advance(PAIR, wanted, many, 0.2)
    for index in range(3):
        one, its = (jax.tree.map(lambda x, i=index: x[i], tree) for tree in (many, wanted))
        alone = advance(PAIR, its, one, 0.2)
        for a, b in zip(jax.tree.leaves(alone), jax.tree.leaves(together), strict=True):
            np.testing.assert_allclose(a, b[index], atol=1e-6)


def test_phases_come_back_within_one_turn() -> None:
    after = advance(PAIR, towards(frequencies=(-40.0,)), a_pair(), 1.0)
    assert ((after.phases >= 0) & (after.phases < 2 * np.pi)).all()
