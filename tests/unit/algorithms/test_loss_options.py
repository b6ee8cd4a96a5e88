"""What the loss and the batch make of their options, by hand-derived numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.types import Transition

from core.algorithms.brax_training import init_normalizer
from core.algorithms.experience import bootstrap_timeouts
from core.algorithms.ppo.learner import Learner
from core.algorithms.ppo.loss import Hyperparameters, loss_of
from core.algorithms.ppo.spec import PPOSpec
from tests import probes

SIZES = {
    "num_envs": 8,
    "batch_size": 8,
    "num_minibatches": 1,
    "unroll_length": 4,
    "policy_hidden_layer_sizes": [4],
    "value_hidden_layer_sizes": [4],
}


def settings(**changes: object) -> PPOSpec:
    return PPOSpec.model_validate({**SIZES, **changes})


def transition(**changes: jax.Array) -> Transition:
    """One step [1, 1, ...] that terminated with the reward 1, where the value was said to be 0."""
    one = jnp.ones((1, 1))
    said = {
        "raw_action": jnp.zeros((1, 1, 1)),
        "log_prob": 0 * one,
        "distribution_params": jnp.zeros((1, 1, 2)),
        "value": 0 * one,
    }
    extras = {"policy_extras": said, "state_extras": {"truncation": 0 * one}}
    seen = jnp.zeros((1, 1, 1))
    return Transition(seen, (), one, 0 * one, seen, extras)._replace(**changes)


@pytest.mark.parametrize(
    ("bound", "expected"),
    [
        # The value is now 0.8, and 1 was due: (1 - 0.8)² / 2 · 0.5, as long as it may move by 0.8.
        (None, 0.01),
        (1.0, 0.01),
        # It may count as 0.5 only, which is further from 1: (1 - 0.5)² / 2 · 0.5.
        (0.5, 0.0625),
    ],
)
def test_a_value_that_moves_past_its_bound_earns_nothing_more(bound: float | None, expected: float) -> None:
    learner = Learner(probes.constant_reward(), settings(clipping_epsilon_value=bound))
    params = jax.tree.map(jnp.zeros_like, jax.jit(learner.init)(jnp.uint32(0)).params)
    params.value["params"]["hidden_1"]["bias"] += 0.8
    networks = learner._networks(normalize=False)
    loss = loss_of(learner.settings, networks, init_normalizer(1), Hyperparameters.of(learner.settings))
    _, metrics = jax.jit(loss)(params, transition(), jax.random.PRNGKey(0))
    assert float(metrics["v_loss"]) == pytest.approx(expected, rel=1e-5)


def test_a_step_that_is_cut_off_becomes_an_end_with_its_own_value_for_the_rest() -> None:
    # Rewards of 1 count twice; V = 3 is in that unit: 1 + 0.5 · 3 / 2 = 1.75. The other step stays.
    both = jnp.ones((2, 1))
    cut_off = jnp.array([[1.0], [0.0]])
    extras = {"policy_extras": {"value": 3 * both}, "state_extras": {"truncation": cut_off}}
    given = transition(reward=both, extras=extras)
    got = bootstrap_timeouts(given, jnp.float32(0.5), jnp.float32(2.0))
    np.testing.assert_allclose(got.reward, [[1.75], [1.0]])
    np.testing.assert_array_equal(got.extras["state_extras"]["truncation"], [[0], [0]])
    np.testing.assert_array_equal(given.extras["state_extras"]["truncation"], cut_off)


def after_one_update(**changes: object) -> tuple[Learner, object]:
    learner = Learner(probes.observed_reward(), settings(**changes))
    state = jax.jit(learner.init)(jnp.uint32(0))
    state, _, _ = jax.jit(learner.update)(state, Hyperparameters.of(learner.settings))
    return learner, state


def test_the_normaliser_learns_what_was_seen_or_nothing_at_all() -> None:
    _, state = after_one_update()
    # 32 observations of -1 and +1: their second moment is 1 = deviation² + mean².
    assert int(state.normalizer.count.lo) == 32
    assert float(state.normalizer.std[0] ** 2 + state.normalizer.mean[0] ** 2) == pytest.approx(1.0)
    _, state = after_one_update(normalize_observations=False)
    assert (int(state.normalizer.count.lo), float(state.normalizer.mean[0])) == (0, 0.0)
    assert float(state.normalizer.std[0]) == 1.0


def test_networks_have_the_layers_asked_for() -> None:
    learner = Learner(
        probes.endless(), settings(policy_hidden_layer_sizes=[5, 3], value_hidden_layer_sizes=[7])
    )
    params = jax.jit(learner.init)(jnp.uint32(0)).params
    shapes = {
        which: [layer["kernel"].shape for _, layer in sorted(getattr(params, which)["params"].items())]
        for which in ("policy", "value")
    }
    # One number is seen; an action has a location and a scale.
    assert shapes == {"policy": [(1, 5), (5, 3), (3, 2)], "value": [(1, 7), (7, 1)]}


@pytest.mark.parametrize(
    ("activation", "expected"),
    # One hidden layer of four, weights 1 and biases 0, sees -2; its outputs add up.
    [
        ("relu", 0.0),
        ("tanh", 4 * np.tanh(-2)),
        ("swish", 4 * -2 / (1 + np.exp(2))),
        ("elu", 4 * np.expm1(-2)),
    ],
)
def test_between_layers_stands_the_activation_asked_for(activation: str, expected: float) -> None:
    learner = Learner(probes.endless(), settings(activation=activation))
    weights = jax.tree_util.tree_map_with_path(
        lambda path, x: jnp.ones_like(x) if "kernel" in jax.tree_util.keystr(path) else jnp.zeros_like(x),
        learner.init(jnp.uint32(0)).params.value,
    )
    network = learner._networks(normalize=True).value_network
    got = network.apply(init_normalizer(1), weights, jnp.array([-2.0]))
    assert float(got) == pytest.approx(expected, rel=1e-5)
