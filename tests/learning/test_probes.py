"""Each probe isolates one thing that a learner must do; the right answers are known."""

from typing import Any

import jax.numpy as jnp
import pytest

from core.algorithms.events import TrainingProgress
from core.algorithms.ppo.networks import make_networks
from core.algorithms.ppo.policy import policy_from_checkpoint
from core.algorithms.run import Run
from tests import probes
from tests.learning.runs import INTENTION, last_evaluation, small_run, small_settings


def value(run: Run[Any], observation: float) -> float:
    """The trained value network's value of an observation."""
    normalizer, _, parameters = policy_from_checkpoint(run.checkpoint())
    network = make_networks(1, 1, small_settings()).value_network
    return float(network.apply(normalizer, parameters, jnp.array([observation])))


def test_the_value_of_a_constant_reward_is_learnt() -> None:
    run = small_run(probes.constant_reward())
    assert last_evaluation(run.events())["eval/episode_reward"] == 1.0
    assert value(run, 0.0) == pytest.approx(1.0, abs=0.05)


def test_the_value_looks_at_the_observation() -> None:
    run = small_run(probes.observed_reward())
    last_evaluation(run.events())
    assert value(run, 1.0) == pytest.approx(1.0, abs=0.05)
    assert value(run, -1.0) == pytest.approx(-1.0, abs=0.05)


def test_a_reward_one_step_ahead_is_discounted_once() -> None:
    # 1 comes with the second of two steps: V(0) = 0.5 · 1, V(1) = 1.
    run = small_run(probes.delayed_reward())
    assert last_evaluation(run.events())["eval/avg_episode_length"] == 2.0
    assert value(run, 0.0) == pytest.approx(0.5, abs=0.05)
    assert value(run, 1.0) == pytest.approx(1.0, abs=0.05)


def test_the_policy_finds_the_better_action() -> None:
    # The reward is minus the squared distance from 0.5; doing nothing gives -0.25.
    assert last_evaluation(small_run(probes.action_reward()).events())["eval/episode_reward"] > -0.01


def test_the_policy_looks_at_the_observation() -> None:
    # The best action is ±0.5, as the observation says; not looking at it gives -0.25 at best.
    run = small_run(probes.observed_action_reward(), entropy_cost=1e-2)
    assert last_evaluation(run.events())["eval/episode_reward"] > -0.05


def test_an_encoder_tells_a_decoder_that_sees_the_body_alone_what_is_wanted() -> None:
    # Without z, the decoder would miss by 0.5: -0.25. Without the body, it would miss by 0.4: -0.16.
    # Three times as fast, some seeds lose again what they had learnt, and which ones depends on the machine.
    run = small_run(probes.intention(), entropy_cost=1e-2, learning_rate=1e-3, network=INTENTION)
    assert last_evaluation(run.events())["eval/episode_reward"] > -0.05


def test_a_heavy_weight_of_the_divergence_leaves_nothing_of_what_is_wanted() -> None:
    # z is then a standard normal whatever is wanted, and its mean says nothing: -0.25 at best.
    run = small_run(probes.intention(), entropy_cost=1e-2, network={**INTENTION, "kl_weight": 100.0})
    events = list(run.events())
    progress = [event.metrics for event in events if isinstance(event, TrainingProgress)][-1]
    assert progress["training/latent_kl"] < 1e-2
    assert progress["training/latent_std"] == pytest.approx(1.0, abs=0.1)
    assert last_evaluation(iter(events))["eval/episode_reward"] < -0.2


def test_a_cut_off_episode_does_not_count_as_an_end() -> None:
    # Every reward is 1 and nothing terminates: V = 1 + 0.5 V = 2. Were the cut after three steps an end,
    # it would be V = 1 + 0.5 · 2/3 · V = 1.5.
    run = small_run(probes.unending_reward(), episode_length=3)
    assert last_evaluation(run.events())["eval/avg_episode_length"] == 3.0
    assert value(run, 0.0) == pytest.approx(2.0, abs=0.1)
