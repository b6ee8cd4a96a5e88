import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.environments.cpg import oscillators, roles
from core.environments.cpg.options import CPGOptions
from core.environments.cpg.oscillators import OscillatorNetwork, at_rest
from core.environments.cpg.roles import Gait, Role, action_size, decode, encode, roles_under, strengths

advance = jax.jit(oscillators.advance, static_argnames=("integrator", "num_steps"))
modulation = jax.jit(roles.modulation)
GAIT = Gait(frequency=2 * np.pi, sweep=0.5, stroke=0.75, lift=0.6)
LEADING, LEFT, RIGHT, TRAILING = Role


def test_arms_row_on_both_sides_of_the_leading_one() -> None:
    assert roles_under(0, 5).tolist() == [LEADING, LEFT, LEFT, RIGHT, RIGHT]
    assert roles_under(3, 5).tolist() == [LEFT, RIGHT, RIGHT, LEADING, LEFT]
    assert roles_under(1, 6).tolist() == [RIGHT, LEADING, LEFT, LEFT, TRAILING, RIGHT]
    assert roles_under(0, 3).tolist() == [LEADING, LEFT, RIGHT]


@pytest.mark.parametrize("num_arms", [3, 6])
def test_another_leading_arm_is_the_same_star_turned(num_arms: int) -> None:
    first = modulation(roles_under(0, num_arms), GAIT)
    for arm in (1, num_arms - 1):
        turned = modulation(roles_under(arm, num_arms), GAIT)
        for name in ("amplitudes", "offsets"):
            np.testing.assert_array_equal(getattr(turned, name), jnp.roll(getattr(first, name), 2 * arm))
        expected = jnp.roll(first.phase_biases, (2 * arm, 2 * arm), axis=(0, 1))
        # Half a turn ahead is half a turn behind.
        np.testing.assert_allclose(jnp.exp(1j * turned.phase_biases), jnp.exp(1j * expected), atol=1e-6)


def test_each_role_has_its_amplitudes_and_offset() -> None:
    wanted = modulation(jnp.array(list(Role)), GAIT)
    pairs = np.stack([wanted.amplitudes, wanted.offsets], axis=-1).reshape(4, 2, 2)  # role, plane, R and X
    np.testing.assert_allclose(pairs[LEADING], [[0, 0], [0, 0.6]])
    np.testing.assert_allclose(pairs[LEFT], [[0.5, 0], [0.75, 0]])
    np.testing.assert_allclose(pairs[RIGHT], [[0.5, 0], [0.75, 0]])
    np.testing.assert_allclose(pairs[TRAILING], [[0, 0], [0.75, 0]])


def test_the_stroke_is_behind_the_sweep_by_the_lag_on_both_sides() -> None:
    # The right side sweeps as the left one half a period later, and all stroke at once.
    biases = modulation(roles_under(0, 3), GAIT.replace(lag=2.5)).phase_biases
    left, right = (biases[2 * arm, 2 * arm + 1] for arm in (1, 2))
    assert (left, right) == pytest.approx((-2.5, np.pi - 2.5))
    assert biases[3, 5] == 0.0


def lock(played: jax.Array, spread: float = np.pi, seconds: float = 10.0) -> np.ndarray:
    """Phases [2 num_arms] of arms that have long been in these roles."""
    num_arms = len(played)
    network = OscillatorNetwork(jnp.asarray(roles.weights(num_arms, 10.0)), 20.0, 20.0)
    phases = jax.random.uniform(jax.random.key(num_arms), (2 * num_arms,), minval=-spread, maxval=spread)
    return np.asarray(
        advance(
            network, modulation(played, GAIT), at_rest(phases), seconds, num_steps=int(seconds / 0.04)
        ).phases
    )


def test_arms_row_as_far_as_they_are_told() -> None:
    gait = Gait(frequency=3.0, sweep=0.6, stroke=0.4, lift=0.5)
    found = strengths(jnp.array([0.0, 0.5, 1.0]), gait)
    np.testing.assert_allclose(found.amplitudes, [0.0, 0.0, 0.3, 0.2, 0.6, 0.4], rtol=1e-6)
    np.testing.assert_array_equal(found.offsets, np.zeros(6))
    # All of them as an arm on the left does.
    left = roles.modulation(jnp.full(3, Role.LEFT), gait)
    np.testing.assert_array_equal(found.phase_biases, left.phase_biases)
    np.testing.assert_array_equal(found.frequencies, left.frequencies)


@pytest.mark.parametrize("num_arms", [3, 4, 8])
def test_rowers_lock_in_step_whoever_leads(num_arms: int) -> None:
    played = roles_under(1, num_arms)
    phases = lock(played).reshape(num_arms, 2)
    rhythm = phases[np.asarray(played) == LEFT][0, 1]  # out of the plane
    due = {LEFT: (np.pi / 2, 0.0), RIGHT: (-np.pi / 2, 0.0), TRAILING: (None, 0.0)}
    for role, arm in zip(played.tolist(), phases, strict=True):
        for phase, bias in zip(arm, due.get(Role(role), (None, None)), strict=True):
            if bias is not None:
                np.testing.assert_allclose(np.exp(1j * (phase - rhythm - bias)), 1, atol=1e-3)


def test_arms_that_choose_their_own_roles_lock_too() -> None:
    # Nobody leads, so the ring is closed: from phases that are far apart it may also lock in a wave that
    # runs around it.
    played = jnp.array([LEFT, RIGHT, LEFT, TRAILING, RIGHT, RIGHT, LEFT, LEFT])
    phases = lock(played, spread=0.01).reshape(8, 2)
    np.testing.assert_allclose(np.exp(1j * (phases[:, 1] - phases[0, 1])), np.ones(8), atol=1e-3)


def test_every_oscillator_is_coupled_to_three_others() -> None:
    for num_arms in range(3, 9):
        weights = roles.weights(num_arms, 2.0)
        np.testing.assert_array_equal(weights, weights.T)
        np.testing.assert_array_equal(weights.sum(axis=1), np.full(2 * num_arms, 6.0))
    with pytest.raises(ValueError, match="3 arms"):
        roles.edges(2)


def test_an_action_stands_for_a_modulation_and_back() -> None:
    num_arms = 6
    options = CPGOptions(max_amplitude=0.95, max_offset=0.9, max_frequency_hz=1.5)
    both = jax.jit(lambda action: encode(decode(action, options), options))
    actions = jax.random.uniform(jax.random.key(0), (4, action_size(num_arms)), minval=-1, maxval=1)
    np.testing.assert_allclose(both(actions), actions, atol=1e-6)
    for arm in (0, 2):
        wanted = modulation(roles_under(arm, num_arms), GAIT)
        action = encode(wanted, options)
        assert (jnp.abs(action) <= 1 + 1e-6).all()
        for a, b in zip(jax.tree.leaves(wanted), jax.tree.leaves(decode(action, options)), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-6)


def test_the_ends_of_an_action_are_the_bounds() -> None:
    options = CPGOptions(max_amplitude=0.95, max_offset=0.9, max_frequency_hz=2.0)
    most, least = (decode(sign * jnp.ones(action_size(3)), options) for sign in (1, -1))
    assert (most.amplitudes[0], most.offsets[0]) == pytest.approx((0.95, 0.9))
    assert (least.amplitudes[0], least.offsets[0]) == pytest.approx((0.0, -0.9))
    assert (most.frequencies[0], least.frequencies[0]) == pytest.approx((4 * np.pi, 0.0))
    assert most.phase_biases[0, 1] == pytest.approx(np.pi)
    assert most.phase_biases[1, 0] == pytest.approx(-np.pi)
