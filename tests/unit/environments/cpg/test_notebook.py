"""The tutorial notebook's generator, derived again from its equations, beside ours.

Five arms; oscillator 2k of arm k in the plane, 2k + 1 out of it; weights 5, gains 20, Euler's steps of
0.04 s, ω = π rad/s, and half of a joint's 30° as the amplitude of rowers and the offset of the leading arm.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.typing import NDArray

from core.environments.cpg import roles
from core.environments.cpg.oscillators import OscillatorNetwork, Oscillators, advance, at_rest, output
from core.environments.cpg.roles import Gait, modulation, roles_under

WEIGHT, GAIN, DT, OMEGA, LIMIT = 5.0, 20.0, 0.04, np.pi, np.pi / 12
OURS = OscillatorNetwork(jnp.asarray(roles.weights(5, WEIGHT)), GAIN, GAIN)


def the_notebooks(
    leading_arms: list[int], phases: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Outputs [T, 10] and the phases at the end, in double precision, one oscillator after the other."""
    coupled = {frozenset({2 * arm, 2 * arm + 1}) for arm in range(5)}
    coupled |= {
        frozenset({2 * arm + kind, 2 * ((arm + 1) % 5) + kind}) for arm in range(5) for kind in (0, 1)
    }
    amplitude, offset = np.zeros((2, 10)), np.zeros((2, 10))  # value and rate of each
    outputs = []
    for lead in leading_arms:
        # One side has the numbers below the leading arm's, the other those above.
        below, above = [(lead - 1) % 5, (lead - 2) % 5], [(lead + 1) % 5, (lead + 2) % 5]
        ahead = {(2 * arm, 2 * arm + 1): np.pi / 2 for arm in below}
        ahead |= {(2 * arm + 1, 2 * arm): np.pi / 2 for arm in above}
        ahead[2 * below[0], 2 * lead] = ahead[2 * lead, 2 * above[0]] = np.pi / 4
        ahead[2 * lead + 1, 2 * below[0] + 1] = ahead[2 * above[0] + 1, 2 * lead + 1] = np.pi / 4
        ahead[2 * below[1], 2 * above[1]] = np.pi
        ahead |= {(j, i): -bias for (i, j), bias in ahead.items()}

        slope = np.full(10, OMEGA)
        for i in range(10):
            for j in range(10):
                if frozenset({i, j}) in coupled and i != j:
                    slope[i] += (
                        WEIGHT * amplitude[0, j] * np.sin(phases[j] - phases[i] - ahead.get((i, j), 0.0))
                    )
        rowers = np.repeat([arm != lead for arm in range(5)], 2)
        up = np.arange(10) == 2 * lead + 1
        for value, goal in ((amplitude, LIMIT * rowers), (offset, LIMIT * up)):
            acceleration = GAIN * (GAIN / 4 * (goal - value[0]) - value[1])
            value += DT * np.stack([value[1], acceleration])
        phases = phases + DT * slope
        outputs.append(offset[0] + amplitude[0] * np.cos(phases))
    return np.array(outputs), phases


@pytest.mark.parametrize("lead", range(5))
def test_outputs_under_one_leading_arm_and_then_another_are_the_notebooks(lead: int) -> None:
    phases = np.random.default_rng(lead).uniform(-0.5, 0.5, 10)
    arms = [lead] * 60 + [(lead + 2) % 5] * 60
    expected, last = the_notebooks(arms, phases)

    def step(now: Oscillators, arm: jax.Array) -> tuple[Oscillators, jax.Array]:
        wanted = modulation(roles_under(arm, 5), Gait(OMEGA, LIMIT, LIMIT, LIMIT))
        after = advance(OURS, wanted, now, DT, "euler")
        return after, output(after)

    now, outputs = jax.lax.scan(step, at_rest(jnp.asarray(phases, jnp.float32)), jnp.array(arms))
    np.testing.assert_allclose(outputs, expected, atol=2e-5)
    np.testing.assert_allclose(np.cos(now.phases), np.cos(last), atol=1e-4)
