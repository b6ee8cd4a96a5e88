"""The intention network: its loss by hand-derived numbers, what each half sees, and where it is refused."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.brax_training import Transition, init_normalizer
from core.algorithms.catalog import least_memory, resolve
from core.algorithms.ppo.intention import IntentionPolicy, Latent
from core.algorithms.ppo.kernels import layout
from core.algorithms.ppo.learner import Learner
from core.algorithms.ppo.loss import Hyperparameters, loss_of, ramped
from core.algorithms.ppo.networks import acting, init_params, make_networks
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.spec import check_resumption
from core.environments import catalog
from core.errors import Rejected
from tests import probes

NETWORK: dict[str, Any] = {
    "kind": "intention",
    "latent": 3,
    "encoder": [8],
    "decoder": [6],
    "places": [[1, 2]],
}
SEEN = jnp.array([[1.0, -2.0, 0.5, 3.0], [0.0, 3.0, -1.0, 1.0]])
KEY = jax.random.key(0)


def settings(**network: Any) -> PPOSpec:
    return PPOSpec.model_validate({"network": {**NETWORK, **network}, "value_hidden_layer_sizes": [4]})


def policy() -> tuple[IntentionPolicy, Any]:
    """A network that sees 4 numbers, of which it encodes the second and the third, and acts with 2."""
    networks: Any = make_networks(4, 2, settings())
    return networks.policy_network, init_params(networks, KEY).policy


def latent(mean: list[float], std: list[float]) -> Latent:
    return Latent(jnp.array(mean), jnp.log(jnp.array(std)), jnp.zeros(0))


def test_the_divergence_is_that_of_normal_distributions() -> None:
    # ½ (μ² + σ² − 1) − ln σ: 0 for N(0, 1); ½ (4 + 1 − 1) = 2 for N(2, 1); and for N(1, 2) it is
    # ½ (1 + 4 − 1) − ln 2 = 1.3069. Their mean is 1.1023.
    assert float(latent([0.0], [1.0]).divergence) == 0.0
    assert float(latent([0.0, 2.0, 1.0], [1.0, 1.0, 2.0]).divergence) == pytest.approx(1.1023, abs=1e-4)


def test_a_step_of_the_intention_counts_only_within_an_episode() -> None:
    # Of two environments with one number each: 0 → 1 → 3, and 0 → 2 | 10, where an episode ends.
    moving = Latent(jnp.array([[[0.0], [0.0]], [[1.0], [2.0]], [[3.0], [10.0]]]), jnp.zeros(()), jnp.zeros(0))
    continues = jnp.array([[1.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    assert float(moving.step(continues)) == pytest.approx((1 + 4 + 4) / 3)


def test_the_gradient_goes_through_the_sample() -> None:
    # z = μ + σ ε: ∂z/∂μ = 1, and ∂z/∂(ln σ) = σ ε = 2 · 3.
    def sampled(mean: jax.Array, log_std: jax.Array) -> jax.Array:
        return Latent(mean, log_std, jnp.zeros(0)).sample(jnp.array(3.0))

    by_mean, by_log_std = jax.grad(sampled, argnums=(0, 1))(jnp.array(1.0), jnp.log(2.0))
    assert (float(by_mean), float(by_log_std)) == (1.0, pytest.approx(6.0))


def test_the_encoder_sees_its_places_and_the_decoder_the_others() -> None:
    network, params = policy()
    normalizer = init_normalizer(4)

    def z(observation: jax.Array) -> jax.Array:
        return network.encode(normalizer, params, observation).mean

    def logits(observation: jax.Array) -> jax.Array:
        body = network.encode(normalizer, params, observation).body
        return network.decode(params, jnp.zeros(3), body)

    encoded, decoded = (
        np.abs(jax.jit(jax.jacobian(function))(SEEN[0])).sum(0) > 0 for function in (z, logits)
    )
    assert encoded.tolist() == [False, True, True, False]
    assert decoded.tolist() == [True, False, False, True]


def test_an_evaluation_takes_the_mean_and_training_keeps_its_noise() -> None:
    networks: Any = make_networks(4, 2, settings())
    params = init_params(networks, KEY)
    triple = (init_normalizer(4), params.policy, params.value)
    actions, _ = acting(networks, triple, deterministic=True)(SEEN, KEY)
    expected = jnp.tanh(networks.policy_network.apply(triple[0], params.policy, SEEN)[..., :2])
    np.testing.assert_allclose(actions, expected, rtol=1e-6)
    _, extras = acting(networks, triple)(SEEN, KEY)
    assert extras["latent_noise"].shape == (2, 3)
    again = networks.policy_network.under(extras["latent_noise"]).apply(triple[0], params.policy, SEEN)
    np.testing.assert_array_equal(again, extras["distribution_params"])


def test_the_ratio_is_one_before_anything_is_learnt_and_the_encoder_has_a_gradient() -> None:
    chosen = settings().model_copy(update={"normalize_advantage": False})
    networks: Any = make_networks(4, 2, chosen)
    params = init_params(networks, KEY)
    normalizer = init_normalizer(4)
    _, acted = acting(networks, (normalizer, params.policy, params.value), compute_value=True)(SEEN, KEY)
    one = jnp.ones((2, 1))
    transitions = one_step(acted, one)
    loss = loss_of(chosen, networks, normalizer, Hyperparameters.of(chosen))
    gradient, metrics = jax.jit(jax.grad(loss, has_aux=True))(params, transitions, KEY)
    # −mean(ratio · advantage) with the advantages 1 − V: where the ratio is 1, its mean is V's less 1.
    assert float(metrics["policy_loss"]) == pytest.approx(float(jnp.mean(acted["value"])) - 1, rel=1e-5)
    of_encoder = jax.tree.leaves(gradient.policy["params"]["encoder"])
    assert all(float(jnp.abs(leaf).max()) > 0 for leaf in of_encoder)
    parts = ("policy_loss", "v_loss", "entropy_loss")
    without = sum(float(metrics[name]) for name in parts)
    # The weight of 1e-3 is there from the first.
    expected = without + 1e-3 * float(metrics["latent_kl"])
    assert float(metrics["total_loss"]) == pytest.approx(expected, rel=1e-6)


def one_step(acted: Any, one: jax.Array) -> Any:
    """One step [2, 1, ...] of each of two environments, which terminated with the reward 1."""
    of_unrolls = jax.tree.map(lambda x: x[:, None], acted)
    extras = {"policy_extras": of_unrolls, "state_extras": {"truncation": 0 * one}}
    return Transition(SEEN[:, None], (), one, 0 * one, SEEN[:, None], extras)


@pytest.mark.parametrize(("updates", "weight"), [(0, 0.0), (1, 0.25), (2, 0.5), (4, 1.0), (9, 1.0)])
def test_the_weight_rises_in_a_line(updates: int, weight: float) -> None:
    chosen = Hyperparameters.of(settings(kl_weight=1.0, kl_ramp_steps=400))
    assert float(ramped(chosen, jnp.int32(updates), 100).kl_weight) == weight


def test_without_a_ramp_the_weight_is_there_from_the_first() -> None:
    chosen = Hyperparameters.of(settings(kl_weight=0.5))
    assert float(ramped(chosen, jnp.int32(0), 100).kl_weight) == 0.5


def test_our_kernels_leave_it_alone() -> None:
    small = {"policy_hidden_layer_sizes": [8], "value_hidden_layer_sizes": [8]}
    assert layout.fits(PPOSpec.model_validate(small), 4, 2)
    assert not layout.fits(PPOSpec.model_validate({**small, "network": NETWORK}), 4, 2)


def test_places_are_found_by_the_names_of_the_observation() -> None:
    info = catalog.find("ant").under(catalog.find("ant").options())
    found = resolve(settings(places=None, encoder_sees=["qvel"]), info, "cpu").network
    assert found is not None
    parts = info.spaces.observation
    expected = [(part.start, part.size) for part in parts if part.name == "qvel"]
    assert sum(size for _, size in found.places or ()) == sum(size for _, size in expected)
    assert found.encoder_sees == ["qvel"]
    # What was found can be sent again.
    assert resolve(PPOSpec(network=found), info, "cpu").network == found


@pytest.mark.parametrize(
    ("network", "place", "sentence"),
    [
        ({"places": None}, "encoder_sees", "no part of the observation of ant is called so. There are: qpos"),
        ({"encoder_sees": ["qvel", "qqq"], "places": None}, "encoder_sees/1", "The encoder is to see 'qqq'"),
        ({"encoder_sees": [".*"], "places": None}, "encoder_sees", "the decoder nothing of the body"),
        ({"encoder_sees": ["qvel"], "places": [[0, 2]]}, "places", "leave `places` out"),
        ({"places": [[0, 2], [1, 2]]}, "places", "overlap"),
        ({"places": [[20, 20]]}, "places", "go beyond the 27 numbers"),
    ],
)
def test_an_encoder_that_does_not_fit_the_observation_is_refused(
    network: dict[str, Any], place: str, sentence: str
) -> None:
    info = catalog.find("ant").under(catalog.find("ant").options())
    with pytest.raises(Rejected, match=sentence) as refused:
        resolve(settings(**network), info, "cpu")
    assert [problem.pointer for problem in refused.value.problems] == [f"/algorithm/network/{place}"]


def test_an_environment_without_names_needs_places() -> None:
    with pytest.raises(Rejected, match="say by `places` what is encoded"):
        Learner(probes.intention(), settings(places=None)).init(jnp.uint32(0))


def test_settings_that_nothing_reads_beside_the_network_are_refused() -> None:
    info = catalog.find("ant").under(catalog.find("ant").options())

    def pointers(given: PPOSpec) -> list[str]:
        with pytest.raises(Rejected) as refused:
            resolve(given, info, "cpu")
        return [problem.pointer for problem in refused.value.problems]

    sizes = PPOSpec.model_validate({"network": NETWORK, "policy_hidden_layer_sizes": [16]})
    assert pointers(sizes) == ["/algorithm/policy_hidden_layer_sizes"]
    lone = PPOSpec.model_validate({"network": {**NETWORK, "smoothness_weight": 0.1}, "unroll_length": 1})
    assert pointers(lone) == ["/algorithm/network/smoothness_weight", "/algorithm/unroll_length"]
    # What a run took can be sent again.
    taken = resolve(PPOSpec.model_validate({"network": NETWORK}), info, "cpu")
    assert resolve(PPOSpec.model_validate(taken.model_dump()), info, "cpu") == taken


@pytest.mark.parametrize(
    ("places", "sentence"),
    [
        ([[2, 3]], "go beyond the 4 numbers"),
        ([[0, 2], [1, 2]], "overlap"),
        ([[0, 4]], "the decoder nothing of the body"),
    ],
)
def test_places_are_checked_where_the_environment_names_no_parts(places: Any, sentence: str) -> None:
    with pytest.raises(Rejected, match=sentence):
        make_networks(4, 2, settings(places=places))


def test_only_the_weights_may_change_in_a_resumed_run() -> None:
    check_resumption(settings(kl_weight=0.5, kl_ramp_steps=7), settings())
    for changed in ({"latent": 4}, {"places": [[0, 2]]}, {"decoder": [7]}):
        with pytest.raises(Rejected, match="cannot resume"):
            check_resumption(settings(**changed), settings())


def test_memory_counts_both_halves_and_the_noise() -> None:
    ant = catalog.find("ant").under(catalog.find("ant").options())
    chosen = settings(places=[[0, 10]])
    made = jax.eval_shape(lambda key: init_params(make_networks(27, 8, chosen), key), KEY)
    count = sum(leaf.size for leaf in jax.tree.leaves(made))
    plain = PPOSpec.model_validate({"value_hidden_layer_sizes": [4]})
    need, without = (least_memory(one, ant, 1).parts for one in (chosen, plain))
    assert need[1].bytes == 4 * 4 * count
    transitions = chosen.batch_size * chosen.num_minibatches * chosen.unroll_length
    assert need[0].bytes - without[0].bytes == 4 * 3 * transitions
