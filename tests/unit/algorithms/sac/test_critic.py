"""The projection of a distribution whose values have moved; numbers by hand."""

import jax
import jax.numpy as jnp
import numpy as np

from core.algorithms.sac.networks import NUM_CRITICS, Critics, projected

ATOMS = jnp.array([0.0, 1.0, 2.0, 3.0])


def test_a_value_between_two_others_shares_its_probability_by_nearness() -> None:
    certain = jnp.array([[0.0, 1.0, 0.0, 0.0]])
    moved = jnp.array([[9.0, 1.25, 9.0, 9.0]])
    np.testing.assert_allclose(projected(certain, moved, ATOMS), [[0.0, 0.75, 0.25, 0.0]], atol=1e-6)


def test_what_moves_beyond_the_ends_stays_there() -> None:
    halves = jnp.array([[0.5, 0.0, 0.0, 0.5]])
    moved = jnp.array([[-4.0, 0.0, 0.0, 7.0]])
    np.testing.assert_allclose(projected(halves, moved, ATOMS), [[0.5, 0.0, 0.0, 0.5]], atol=1e-6)


def test_an_episode_that_ends_leaves_its_reward_alone() -> None:
    # All values become the reward, 2: nothing follows.
    spread = jnp.full((1, 4), 0.25)
    moved = jnp.full((1, 4), 2.0)
    np.testing.assert_allclose(projected(spread, moved, ATOMS), [[0.0, 0.0, 1.0, 0.0]], atol=1e-6)


def test_the_mean_moves_as_the_values_do() -> None:
    probabilities = jax.random.dirichlet(jax.random.key(0), jnp.ones(4), (5,))
    moved = jnp.tile(0.5 + 0.8 * ATOMS, (5, 1))
    means = projected(probabilities, moved, ATOMS) @ ATOMS
    np.testing.assert_allclose(means, 0.5 + 0.8 * (probabilities @ ATOMS), rtol=1e-5)


def test_nothing_beside_it_is_computed_for_every_pair_of_values() -> None:
    # One fence before and one behind: XLA fuses nothing across them.
    batch = jax.ShapeDtypeStruct((5, 4), jnp.float32)
    assert jax.jit(projected).lower(batch, batch, ATOMS).as_text().count("optimization_barrier") == 2


def test_the_critics_differ_from_the_beginning() -> None:
    critics = Critics((8,), 4, jax.nn.relu, layer_norm=True)
    params = critics.init(jax.random.key(0), observation_size=3, action_size=2)
    first, *others = critics.logits(params, jnp.ones((1, 3)), jnp.ones((1, 2)))
    assert len(others) == NUM_CRITICS - 1
    assert all(not jnp.allclose(first, other) for other in others)
