from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.acme import running_statistics
from brax.training.agents.ppo.losses import compute_ppo_loss
from brax.training.types import Transition

from core.algorithms.brax_training import PPONetworkParams, init_normalizer
from core.algorithms.experience import (
    StepOutcomes,
    collect,
    cut_into_unrolls,
    lost_too_many,
    of_whole_episodes,
    summarise,
)
from core.algorithms.ppo.learner import Learner, TrainingState
from core.algorithms.ppo.loss import Hyperparameters, loss_of
from core.algorithms.ppo.networks import init_params, make_networks
from core.algorithms.ppo.spec import PPOSpec
from core.environments.environment import Environment, State
from core.environments.wrappers.autoreset import start_episodes
from core.environments.wrappers.vectorized import VectorEnv
from core.physics.engine import NOMINAL, ModelFields
from tests.overflowing import Overflowing
from tests.probes import Probe, endless

SETTINGS = PPOSpec.model_validate({"policy_hidden_layer_sizes": [8], "value_hidden_layer_sizes": [8]})


def some_transitions(num_steps: int, num_envs: int) -> Transition:
    """Random transitions [num_steps, num_envs, ...] with 3 numbers seen and 2 acted."""
    random = np.random.default_rng(0)

    def normal(*shape: int) -> jax.Array:
        return jnp.asarray(random.normal(size=(num_steps, num_envs, *shape)), jnp.float32)

    def coin() -> jax.Array:
        return jnp.asarray(random.integers(0, 2, (num_steps, num_envs)), jnp.float32)

    acted = {
        "raw_action": normal(2),
        "log_prob": normal(),
        "distribution_params": normal(4),
        "value": normal(),
    }
    return Transition(
        observation=normal(3),
        action=normal(2),
        reward=normal(),
        discount=coin(),
        next_observation=normal(3),
        extras={"policy_extras": acted, "state_extras": {"truncation": coin()}},
    )


def test_unrolls_are_pieces_of_one_environment_in_time() -> None:
    # Step t of environment n is 10 t + n: six steps of two environments are four unrolls of three.
    numbers = jnp.arange(6)[:, None] * 10 + jnp.arange(2)
    transitions = Transition(numbers, (), numbers, numbers, numbers + 10, ())
    batch = cut_into_unrolls(transitions, 3)
    np.testing.assert_array_equal(batch.reward, [[0, 10, 20], [1, 11, 21], [30, 40, 50], [31, 41, 51]])
    np.testing.assert_array_equal(batch.next_observation, [[30], [31], [60], [61]])


@pytest.mark.parametrize(
    ("unroll_length", "changes"),
    [
        (4, {}),
        (20, {"normalize_advantage": False}),
        (5, {"clipping_epsilon_value": 0.1, "max_grad_norm": 1.0}),
    ],
)
def test_the_loss_is_brax_s_though_less_is_kept_and_normalisation_comes_first(
    unroll_length: int, changes: dict[str, object]
) -> None:
    numbers = {"discounting": 0.9, "entropy_cost": 0.02, "clipping_epsilon": 0.2, "reward_scaling": 0.5}
    settings = PPOSpec.model_validate({**SETTINGS.model_dump(), **numbers, **changes})
    transitions = some_transitions(num_steps=2 * unroll_length, num_envs=3)
    normalizer = running_statistics.update(init_normalizer(3), 1.0 + 2.0 * transitions.observation)
    params = jax.jit(partial(init_params, make_networks(3, 2, settings)))(jax.random.PRNGKey(0))
    key = jax.random.PRNGKey(1)

    kept = cut_into_unrolls(transitions._replace(action=()), unroll_length)
    kept = kept._replace(
        observation=running_statistics.normalize(kept.observation, normalizer),
        next_observation=running_statistics.normalize(kept.next_observation, normalizer),
    )
    networks = make_networks(3, 2, settings, normalize=False)
    loss = loss_of(settings, networks, init_normalizer(3), Hyperparameters.of(settings))
    ours, our_metrics = jax.jit(jax.grad(loss, has_aux=True))(params, kept, key)

    # Brax's own arrangement: everything, [unrolls, time, ...], and networks that normalise.
    whole = jax.tree.map(
        lambda x: jnp.swapaxes(x.reshape((2, unroll_length, *x.shape[1:])), 1, 2).reshape(
            (6, unroll_length, *x.shape[2:])
        ),
        transitions,
    )

    def braxs_loss(params: PPONetworkParams) -> tuple[jax.Array, dict[str, jax.Array]]:
        return compute_ppo_loss(
            params,
            normalizer,
            whole,
            key,
            make_networks(3, 2, settings),
            normalize_advantage=settings.normalize_advantage,
            vf_coefficient=settings.vf_loss_coefficient,
            clipping_epsilon_value=settings.clipping_epsilon_value,
            gae_lambda=settings.gae_lambda,
            **numbers,
        )

    brax, brax_metrics = jax.jit(jax.grad(braxs_loss, has_aux=True))(params)
    for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(brax), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=2e-6)
    assert our_metrics.keys() == brax_metrics.keys()
    for name, value in brax_metrics.items():
        assert float(our_metrics[name]) == pytest.approx(float(value), rel=2e-5, abs=1e-6), name


class Marked(Probe):
    """Shows the random number that its episode began with, at every step."""

    def reset(self, key: jax.Array) -> State:
        return replace(super().reset(key), obs=jax.random.uniform(key)[None])


def starts_seen(learner: Learner, state: TrainingState) -> tuple[TrainingState, set[float]]:
    """The state after one more update, and the starts of the episodes that then run."""
    hyperparameters = Hyperparameters.of(learner.settings)
    after, _, _ = jax.jit(learner.update)(state, hyperparameters)
    return after, set(np.asarray(after.episodes.state.obs[:, 0]).tolist())


def learner_of_short_episodes(**changes: object) -> Learner:
    # 64 environments act 4 times in an update, and every second action ends an episode.
    sizes = {"num_envs": 64, "batch_size": 64, "num_minibatches": 1, "unroll_length": 4, "episode_length": 2}
    layers = {"policy_hidden_layer_sizes": [4], "value_hidden_layer_sizes": [4]}
    env = Marked(lambda obs, time, action: (action, jnp.zeros(())))
    return Learner(env, PPOSpec.model_validate({**sizes, **layers, **changes}))


@pytest.mark.extra
def test_episodes_begin_in_fresh_states_of_their_update() -> None:
    learner = learner_of_short_episodes(reset_pool_size=5)
    state = jax.jit(learner.init)(jnp.uint32(0))
    first = set(np.asarray(state.episodes.state.obs[:, 0]).tolist())
    state, second = starts_seen(learner, state)
    state, third = starts_seen(learner, state)
    assert len(first) == 64
    # 64 draws among five miss one of them with probability below 5 · 0.8**64 < 1e-5.
    assert (len(second), len(third)) == (5, 5)
    assert not first & second
    assert not second & third


def test_without_a_pool_every_environment_goes_back_to_its_own_start() -> None:
    learner = learner_of_short_episodes(reset_pool_size=0)
    state = jax.jit(learner.init)(jnp.uint32(0))
    after, _ = starts_seen(learner, state)
    np.testing.assert_array_equal(after.episodes.state.obs, state.episodes.state.obs)


def test_lengths_and_scores_are_told_of_whole_episodes_only() -> None:
    # Three environments act three times. The first two began with lengths 2 and 1 of 3, and end after one
    # action and two; the third began with the run, and its end is the only one of a whole episode.
    ended = jnp.array([[3, 0, 0], [0, 3, 0], [0, 0, 3]])
    ones = jnp.ones((3, 3))
    outcome = StepOutcomes(
        ones, ended, ended * 1.0, jnp.where(ended > 0, 1.0, 0.0), 0 * ones, ones, {}, 0 * ones
    )
    told = summarise(of_whole_episodes(outcome, jnp.int32(0)))
    assert {name: float(told[name]) for name in ("episodes", "score", "length", "falls")} == {
        **{"episodes": 1.0, "score": 3.0},
        **{"length": 3.0, "falls": 1.0},
    }
    # Once everyone has acted for longer than an episode lasts, all of them are whole.
    assert float(summarise(of_whole_episodes(outcome, jnp.int32(3)))["episodes"]) == 3.0


@pytest.mark.parametrize(
    ("num_envs", "lost", "too_many"), [(4, 1, False), (4, 2, True), (100, 3, False), (100, 4, True)]
)
def test_a_run_may_lose_one_body_or_a_hundredth(num_envs: int, lost: int, *, too_many: bool) -> None:
    # Of three steps: one of 12 is more than a hundredth, but it is one. Three of 300 are a hundredth.
    ones, none = jnp.ones((3, num_envs)), jnp.zeros((3, num_envs))
    outcome = StepOutcomes(
        ones, ones.astype(jnp.int32), ones, ones, none.at[1, :lost].set(1.0), ones, {}, none
    )
    assert lost_too_many(outcome).tolist() == [False, too_many, False]


def test_networks_see_observations_within_the_bound_and_the_normaliser_sees_all() -> None:
    # The environment shows 0, 1, 2 and so on: mean 7.5, deviation ((16² - 1) / 12)^½.
    sizes = {"num_envs": 2, "batch_size": 2, "num_minibatches": 1, "unroll_length": 16, "episode_length": 99}
    layers = {"policy_hidden_layer_sizes": [4], "value_hidden_layer_sizes": [4]}
    bound = {"normalize_observations_max_abs_value": 1e-12}
    learner = Learner(endless(), PPOSpec.model_validate({**sizes, **layers, **bound}))
    before = jax.jit(learner.init)(jnp.uint32(0))
    after, _, _ = jax.jit(learner.update)(before, Hyperparameters.of(learner.settings))
    np.testing.assert_allclose(after.normalizer.mean, [7.5], rtol=1e-5)
    np.testing.assert_allclose(after.normalizer.std, [(255 / 12) ** 0.5], rtol=1e-5)
    # A gradient is the observation times what comes from above: less than Adam notices (1e-8) for what weighs
    # observations, and not so for what is added to them.
    for one in ("policy", "value"):
        had, has = (getattr(state.params, one)["params"]["hidden_0"] for state in (before, after))
        np.testing.assert_allclose(has["kernel"], had["kernel"], atol=1e-6)
        assert float(jnp.max(jnp.abs(has["bias"] - had["bias"]))) > 1e-4


class Measured(Probe):
    """Reports its age as a height, and its reward as the only term."""

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        zero = jnp.zeros(())
        return replace(super().reset(key, model), metrics={"height": zero, "reward_task": zero})

    def step(self, state: State, action: jax.Array) -> State:
        after = super().step(state, action)
        return replace(after, metrics={"height": after.physics.time, "reward_task": after.reward})


def outcome_of_four_steps(env: Environment) -> tuple[dict[str, float], float]:
    """Metrics of 8 environments that act with ±0.5 four times, under a limit of four; how many show +1."""

    def policy(observation: jax.Array, key: jax.Array) -> tuple[jax.Array, dict[str, jax.Array]]:
        return jnp.full_like(observation, -0.5), {}

    envs = VectorEnv(env)
    episodes = start_episodes(envs, jax.random.PRNGKey(0), 8, keep_first=True)
    keys = jax.random.split(jax.random.PRNGKey(1), 4)
    _, (_, outcome) = collect(envs, policy, episodes, keys, episode_length=4)
    told = {name: float(value) for name, value in summarise(outcome).items()}
    return told, float(jnp.sum(episodes.state.obs > 0))


def test_falls_are_the_ends_that_the_environment_made_and_not_the_clock() -> None:
    # An environment of +1 falls with its third step and begins anew; the clock ends one of -1 at its fourth.
    told, falling = outcome_of_four_steps(
        Probe(
            lambda obs, time, action: (action, jnp.where((obs > 0) & (time >= 2), 1.0, 0.0)), random_sign=True
        )
    )
    assert 0 < falling < 8
    assert (told["episodes"], told["falls"]) == (8, falling)
    assert told["length"] == 3 * falling + 4 * (8 - falling)
    # Every action is -0.5, which is the speed; its square is 0.25.
    assert (told["forward_speed"], told["control_effort"]) == (-0.5, 0.25)
    assert "x_velocity" not in told


def test_every_metric_of_the_environment_is_told_as_its_mean_over_the_steps() -> None:
    told, falling = outcome_of_four_steps(
        Measured(
            lambda obs, time, action: (2 * action, jnp.where((obs > 0) & (time >= 2), 1.0, 0.0)),
            random_sign=True,
        )
    )
    # Ages 1, 2, 3 and, after the fall, 1 again: 7 in all. Without a fall 1 + 2 + 3 + 4 = 10.
    assert told["height"] == pytest.approx((7 * falling + 10 * (8 - falling)) / 32)
    assert told["reward_task"] == -1.0
    assert "forward_speed" not in told


def test_lost_contacts_are_told_as_the_share_of_steps_that_lost_some() -> None:
    # Nobody falls; each environment's second step of four loses some.
    env = Probe(lambda obs, time, action: (action, jnp.zeros(())))
    assert outcome_of_four_steps(Overflowing(env))[0]["physics_overflow"] == 0.25
    assert outcome_of_four_steps(env)[0]["physics_overflow"] == 0.0
