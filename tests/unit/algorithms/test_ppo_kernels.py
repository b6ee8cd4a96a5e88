"""The kernels for PPO's gradient steps, interpreted without a GPU: against Brax's loss, and XLA's steps."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.brax_training import Transition, init_normalizer
from core.algorithms.brax_training import networks as brax_networks
from core.algorithms.ppo.kernels import layout
from core.algorithms.ppo.kernels.gradient import HYPERPARAMETERS, Chosen, gradient
from core.algorithms.ppo.kernels.layout import KernelLayout, KernelSizes, rounded_up
from core.algorithms.ppo.kernels.learn import _flattened, learn
from core.algorithms.ppo.learner import Learner, TrainingState
from core.algorithms.ppo.loss import ADAM, METRICS, Hyperparameters, loss_of
from core.algorithms.ppo.networks import init_params, make_networks
from core.algorithms.ppo.spec import PPOSpec
from tests import probes
from tests.extra import extra

OBS, ACT = 5, 3
SETTINGS = {
    "num_envs": 64,
    "batch_size": 32,
    "num_minibatches": 2,
    "unroll_length": 3,
    "num_updates_per_batch": 2,
    "policy_hidden_layer_sizes": [8, 20],
    "value_hidden_layer_sizes": [16],
    "activation": "tanh",
    "discounting": 0.9,
    "entropy_cost": 0.01,
    "clipping_epsilon": 0.2,
    "learning_rate": 1e-3,
}


def settings(**changes: object) -> PPOSpec:
    return PPOSpec.model_validate({**SETTINGS, **changes})


def networks_and_batch(spec: PPOSpec) -> tuple[Any, Any, Transition]:
    """Networks, their parameters, and unrolls in which some episodes end and some are cut off."""
    networks = make_networks(OBS, ACT, spec, normalize=False)
    keys = jax.random.split(jax.random.PRNGKey(1), 6)
    shape = (spec.batch_size * spec.num_minibatches, spec.unroll_length)
    seen = jax.random.normal(keys[0], (shape[0], shape[1] + 1, OBS))
    logits = 0.3 * jax.random.normal(keys[1], (*shape, 2 * ACT))
    of_actions = networks.parametric_action_distribution
    raw = of_actions.sample_no_postprocessing(logits, keys[2])
    ended = (jax.random.uniform(keys[3], shape) < 0.2).astype(jnp.float32)
    cut_off = ended * (jax.random.uniform(keys[4], shape) < 0.5)
    acted = {
        "raw_action": raw,
        "log_prob": of_actions.log_prob(logits, raw),
        "distribution_params": logits,
    }
    batch = Transition(
        observation=seen[:, :-1],
        action=(),
        reward=jax.random.normal(keys[5], shape),
        discount=1 - ended,
        next_observation=seen[:, -1:],
        extras={"policy_extras": acted, "state_extras": {"truncation": cut_off}},
    )
    return networks, init_params(networks, jax.random.PRNGKey(0)), batch


@pytest.mark.extra
@pytest.mark.parametrize("activation", ["tanh", "swish"])
def test_the_gradient_and_the_losses_are_those_of_braxs_loss(activation: str) -> None:
    spec = settings(activation=activation)
    compare_with_brax(spec, *networks_and_batch(spec))


@pytest.mark.extra
@pytest.mark.parametrize("offset", [1e4, 1e5])
def test_l2_the_gradient_is_braxs_where_rewards_are_large(offset: float) -> None:
    """As the audit's kernel_variance.py measures it: a mean of squares had no digits left."""
    spec = settings(unroll_length=1)
    networks, params, batch = networks_and_batch(spec)
    zero = jnp.zeros_like(batch.discount)
    batch = batch._replace(reward=batch.reward + offset, discount=zero + 1)
    batch.extras["state_extras"]["truncation"] = zero
    # float32 keeps this much of the differences from the mean for numbers of this size.
    compare_with_brax(spec, networks, params, batch, of_policy=2e-7 * offset)


def compare_with_brax(
    spec: PPOSpec, networks: Any, params: Any, batch: Transition, of_policy: float | None = None
) -> None:
    """of_policy: compare the policy's gradient alone, and so closely."""
    activation = spec.activation
    hyperparameters = Hyperparameters.of(spec)
    order = jax.random.permutation(jax.random.PRNGKey(2), 64).astype(jnp.int32)
    second, key = order[32:], jax.random.PRNGKey(3)
    loss = loss_of(spec, networks, init_normalizer(OBS), hyperparameters)
    minibatch = jax.tree.map(lambda x: x[second], batch)
    expected, metrics = jax.grad(loss, has_aux=True)(params, minibatch, key)

    layout = KernelLayout.of(OBS, ACT, spec.policy_hidden_layer_sizes, spec.value_hidden_layer_sizes)
    # Brax's loss draws its noise in this shape, by this key.
    drawn = jax.random.normal(key, (spec.unroll_length, 32, ACT)).swapaxes(0, 1)
    noise = jnp.zeros((64, spec.unroll_length, rounded_up(ACT))).at[second, :, :ACT].set(drawn)
    hyper = jnp.stack([getattr(hyperparameters, name) for name in HYPERPARAMETERS])
    sizes = KernelSizes(
        layout, brax_networks.ACTIVATION[activation], ACT, spec.unroll_length, 32, interpret=True
    )
    chosen = Chosen(order, jnp.array([1], jnp.int32), noise)
    found, parts = gradient(sizes, layout.pack(params), _flattened(batch), chosen, hyper)

    if of_policy is not None:
        end = layout.value[0].start
        np.testing.assert_allclose(found[:end], layout.pack(expected)[:end], atol=of_policy)
        return
    np.testing.assert_allclose(found, layout.pack(expected), atol=2e-6)
    for name, part in zip(METRICS, parts, strict=True):
        assert float(part) == pytest.approx(float(metrics[name]), rel=2e-5, abs=2e-6), name


def test_passes_over_a_batch_end_where_xlas_operations_end() -> None:
    # Without a cost of entropy the noise, which is drawn in another shape, changes nothing.
    spec = settings(entropy_cost=0.0, max_grad_norm=0.3)
    _, params, batch = networks_and_batch(spec)
    hyperparameters, key = Hyperparameters.of(spec), jax.random.PRNGKey(4)
    learner = Learner(probes.constant_reward(), spec)
    state = learner.init(jnp.uint32(0)).replace(params=params, optimizer=ADAM.init(params))
    learner = _Sized(probes.constant_reward(), spec)
    (*expected, _), expected_metrics = jax.jit(learner._learn)(state, batch, hyperparameters, key)
    found, metrics = jax.jit(
        lambda: learn(spec, (params, state.optimizer), batch, hyperparameters, key, interpret=True)
    )()
    assert jax.tree.structure(found) == jax.tree.structure(tuple(expected))
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, atol=2e-6)
    assert {name: pytest.approx(float(value), rel=1e-4, abs=1e-6) for name, value in metrics.items()} == {
        name: float(value) for name, value in expected_metrics.items()
    }


class _Sized(Learner):
    """A learner of networks with our sizes, whatever its environment's."""

    def _networks(self, *, normalize: bool) -> Any:
        return make_networks(OBS, ACT, self.settings, normalize=normalize)


@pytest.mark.extra
def test_runs_that_train_together_each_get_their_own_result() -> None:
    spec = settings()
    _, params, batch = networks_and_batch(spec)
    hyperparameters, keys = Hyperparameters.of(spec), jax.random.split(jax.random.PRNGKey(5), 2)
    learnt = (params, ADAM.init(params))

    def one(key: jax.Array) -> Any:
        return learn(spec, learnt, batch, hyperparameters, key, interpret=True)[0][0]

    together = jax.jit(jax.vmap(one))(keys)
    for index, key in enumerate(keys):
        alone = jax.jit(one)(key)
        for stacked, single in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(stacked[index], single, atol=1e-6)


@pytest.mark.parametrize("activation", ["swish", *extra("tanh", "relu", "elu")])
def test_triton_takes_what_the_kernels_do(activation: str) -> None:
    spec = settings(activation=activation)
    _, params, batch = networks_and_batch(spec)
    given = (params, ADAM.init(params), batch, Hyperparameters.of(spec), jax.random.PRNGKey(0))
    traced = jax.jit(lambda p, o, b, h, key: learn(spec, (p, o), b, h, key)).trace(*given)
    program = traced.lower(lowering_platforms=("cuda",)).as_text()
    # One call for values, for advantages and for gradients, in the body of a loop.
    assert all(program.count(f"ppo_{name}") for name in ("values", "advantages", "gradients"))


def test_triton_takes_the_kernels_of_several_seeds() -> None:
    spec = settings()
    _, params, batch = networks_and_batch(spec)
    own = jax.tree.map(lambda x: jnp.stack([x, x]), (params, ADAM.init(params), batch, jax.random.PRNGKey(0)))
    seeds = jax.vmap(lambda p, o, b, key, h: learn(spec, (p, o), b, h, key), (0, 0, 0, 0, None))
    program = (
        jax.jit(seeds).trace(*own, Hyperparameters.of(spec)).lower(lowering_platforms=("cuda",)).as_text()
    )
    assert all(program.count(f"ppo_{name}") for name in ("values", "advantages", "gradients"))


def test_packed_parameters_come_back_and_the_padding_is_zero() -> None:
    spec = settings()
    _, params, _ = networks_and_batch(spec)
    layout = KernelLayout.of(OBS, ACT, spec.policy_hidden_layer_sizes, spec.value_hidden_layer_sizes)
    packed = layout.pack(params)
    # Rounded to 16 or 32: policy 16·16 + 16, 16·32 + 32, twice 32·16 + 16; value 16·16 + 16, 16·16 + 16.
    assert packed.shape == (layout.size,) == (272 + 544 + 2 * 528 + 2 * 272,)
    assert np.count_nonzero(packed) <= sum(x.size for x in jax.tree.leaves(params))
    back = layout.unpack(packed, params)
    assert jax.tree.structure(back) == jax.tree.structure(params)
    jax.tree.map(np.testing.assert_array_equal, back, params)


@pytest.mark.parametrize(
    ("changes", "observation_size", "fits"),
    [
        ({}, 27, True),
        ({}, 128, True),
        ({}, 129, False),
        ({}, {"state": 27}, False),
        ({"value_hidden_layer_sizes": [64, 64]}, 27, True),
        ({"value_hidden_layer_sizes": [256]}, 27, False),
        ({"batch_size": 48}, 27, True),
        ({"batch_size": 24}, 27, False),
        ({"batch_size": 4096, "num_envs": 8192}, 27, True),
        ({"batch_size": 8192, "num_envs": 16384}, 27, False),
        ({"batch_size": 4096, "num_minibatches": 1024, "num_envs": 4096, "unroll_length": 2}, 27, True),
        ({"batch_size": 4096, "num_minibatches": 1024, "num_envs": 4096, "unroll_length": 4}, 27, False),
        ({"activation": "sigmoid"}, 27, False),
        ({"normalize_advantage": False}, 27, False),
        ({"clipping_epsilon_value": 0.2}, 27, False),
        ({"learning_rate_schedule": "ADAPTIVE_KL"}, 27, False),
        ({"learning_rate_schedule": "LINEAR"}, 27, True),
    ],
)
def test_only_what_the_kernels_compute_is_given_to_them(
    changes: dict[str, object], observation_size: Any, fits: bool
) -> None:
    assert layout.fits(settings(**changes), observation_size, 8) is fits


def test_a_cpu_has_no_use_for_them() -> None:
    assert not layout.usable()
    learner = Learner(probes.constant_reward(), settings())
    assert not learner.has_kernels
    assert isinstance(learner.init(jnp.uint32(0)), TrainingState)
