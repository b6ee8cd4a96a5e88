"""Options of PPO, each where it makes a difference that is known."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.events import TrainingProgress
from core.algorithms.ppo.learner import FORMAT
from core.algorithms.ppo.networks import make_networks
from core.algorithms.ppo.policy import policy_from_checkpoint
from core.algorithms.run import Run
from core.environments.environment import State
from tests import probes
from tests.learning.runs import STEPS_PER_UPDATE, checkpoints, last_evaluation, small_run, small_settings
from tests.probes import Probe

pytestmark = pytest.mark.extra


def value(run: Run[Any], observation: object, observation_size: object = 1, **changes: object) -> float:
    """The trained value network's value of an observation."""
    normalizer, _, parameters = policy_from_checkpoint(run.checkpoint())
    network = make_networks(observation_size, 1, small_settings(**changes)).value_network
    return float(network.apply(normalizer, parameters, observation))


def test_a_step_that_is_always_cut_off_teaches_nothing_unless_it_is_bootstrapped() -> None:
    # Every reward is 1, every episode one step long. Bootstrapped, V = 1 + 0.5 V = 2.
    run = small_run(probes.unending_reward(), episode_length=1, bootstrap_on_timeout=True)
    last_evaluation(run.events())
    assert value(run, jnp.zeros(1)) == pytest.approx(2.0, abs=0.05)
    # Left out, the value stays at its beginning: biases 0 and an observation 0 give 0.
    run = small_run(probes.unending_reward(), episode_length=1)
    last_evaluation(run.events())
    assert value(run, jnp.zeros(1)) == pytest.approx(0.0, abs=0.05)


def test_begun_episodes_are_bootstrapped_like_others_and_change_nothing_that_is_told_of_episodes() -> None:
    # As above, with episodes of four actions that began at random: V = 1 + 0.5 V = 2 wherever one is cut off.
    options = {"bootstrap_on_timeout": True, "random_initial_episode_length": True}
    run = small_run(probes.unending_reward(), episode_length=4, epoch_s=0.0, **options)
    events = list(run.events())
    assert value(run, jnp.zeros(1)) == pytest.approx(2.0, abs=0.05)
    assert len(np.unique(FORMAT.read(run.checkpoint())[1]["episodes"]["length"])) == 4
    # Ends of episodes that had begun before the run are not told; all others have four rewards of 1.
    told = [event.metrics for event in events if isinstance(event, TrainingProgress)]
    for name in ("training/episode_reward", "training/episode_length"):
        assert {metrics[name] for metrics in told} == {4.0}
    evaluation = last_evaluation(iter(events))
    assert (evaluation["eval/episode_reward"], evaluation["eval/avg_episode_length"]) == (4.0, 4.0)


def test_a_run_with_clipped_values_learns_the_same_value() -> None:
    run = small_run(probes.constant_reward(), clipping_epsilon_value=0.1)
    last_evaluation(run.events())
    assert value(run, jnp.zeros(1)) == pytest.approx(1.0, abs=0.05)


def learning_rates(**changes: object) -> list[float]:
    """The mean learning rate of each of four updates of 16 minibatches, beginning with 1e-3."""
    run = small_run(
        probes.action_reward(),
        num_timesteps=4 * STEPS_PER_UPDATE,
        epoch_s=0.0,
        num_evals=0,
        **{"learning_rate": 1e-3, "learning_rate_schedule": "ADAPTIVE_KL", **changes},
    )
    events = [event for event in run.events() if isinstance(event, TrainingProgress)]
    assert float(FORMAT.read(run.checkpoint())[1]["learning_rate"]) > 0
    return [event.metrics["training/learning_rate"] for event in events]


def test_the_learning_rate_rises_to_its_bound_where_the_policy_may_move_freely() -> None:
    # 1e-3 · 1.5^n reaches 1e-2 with the sixth minibatch that moved the policy at all.
    rates = learning_rates(desired_kl=100.0)
    assert rates[0] > 5e-3
    assert rates[1:] == pytest.approx([1e-2] * 3, rel=1e-5)


def test_the_learning_rate_falls_to_its_bound_where_the_policy_may_hardly_move() -> None:
    rates = learning_rates(desired_kl=1e-9, learning_rate_schedule_min_lr=1e-4)
    assert rates[0] < 5e-4
    assert rates[1:] == pytest.approx([1e-4] * 3, rel=1e-5)


def test_the_learning_rate_falls_in_a_line_over_the_budget_to_its_bound() -> None:
    rates = learning_rates(learning_rate_schedule="LINEAR", learning_rate_schedule_min_lr=4e-4)
    assert rates == pytest.approx([1e-3, 7.5e-4, 5e-4, 4e-4], rel=1e-5)


@pytest.mark.parametrize("schedule", ["LINEAR", "ADAPTIVE_KL"])
def test_a_run_with_every_option_resumes_as_if_it_had_not_stopped(schedule: str) -> None:
    options = {
        "num_timesteps": 8 * STEPS_PER_UPDATE,  # of twice as many steps in an update
        "num_evals": 0,
        "action_repeat": 2,
        "episode_length": 5,
        "learning_rate_schedule": schedule,
        "clipping_epsilon_value": 0.2,
        "bootstrap_on_timeout": True,
        "activation": "elu",
        "random_initial_episode_length": True,
        "normalize_observations_max_abs_value": 0.5,
    }
    env = probes.observed_action_reward()
    straight = checkpoints(small_run(env, epoch_s=1000.0, **options))
    stopped = small_run(env, epoch_s=0.0, **options)
    next(event for event in stopped.events() if isinstance(event, TrainingProgress))
    assert stopped.step == 2 * STEPS_PER_UPDATE
    assert checkpoints(small_run(env, resume=stopped.checkpoint(), **options)) == straight


def test_lengths_and_budgets_count_steps_of_the_world_however_long_an_action_is_held() -> None:
    # Seven steps are four actions of two: 8 steps with a reward of 1 each.
    run = small_run(
        probes.unending_reward(), num_timesteps=4 * STEPS_PER_UPDATE, action_repeat=2, episode_length=7
    )
    events = list(run.events())
    progress = [event for event in events if isinstance(event, TrainingProgress)][-1]
    assert (progress.step, run.step) == (4 * STEPS_PER_UPDATE, 4 * STEPS_PER_UPDATE)
    assert int(FORMAT.read(run.checkpoint())[1]["num_updates"]) == 2
    assert progress.metrics["training/episode_length"] == 8.0
    evaluation = last_evaluation(iter(events))
    assert evaluation["eval/avg_episode_length"] == 8.0
    assert evaluation["eval/episode_reward"] == 8.0


VIEWS = {"state": 1, "privileged_state": 1}


class TwoViews(Probe):
    """The policy is shown nothing, and whoever is privileged the sign."""

    def reset(self, key: jax.Array) -> State:
        return self._shown(super().reset(key))

    def step(self, state: State, action: jax.Array) -> State:
        return self._shown(super().step(replace(state, obs=state.obs["privileged_state"]), action))

    def _shown(self, state: State) -> State:
        return replace(state, obs={"state": jnp.zeros(1), "privileged_state": state.obs})


def two_views(probe: Probe) -> TwoViews:
    return TwoViews(probe.rule, random_sign=probe.random_sign, observation_size=VIEWS)


def test_the_value_sees_more_than_the_policy_where_that_is_asked_for() -> None:
    keys = {"value_obs_key": "privileged_state"}
    run = small_run(two_views(probes.observed_reward()), **keys)
    last_evaluation(run.events())
    for sign in (-1.0, 1.0):
        seen = {"state": jnp.zeros(1), "privileged_state": jnp.array([sign])}
        got = value(run, seen, VIEWS, **keys)
        assert got == pytest.approx(sign, abs=0.05)


def test_the_policy_acts_on_its_own_observation_alone() -> None:
    # Blind, no action is better than 0, which earns -0.25; with the sign it is ±0.5 for nothing.
    env = two_views(probes.observed_action_reward())
    budget = {"entropy_cost": 1e-2}
    blind = last_evaluation(small_run(env, value_obs_key="privileged_state", **budget).events())
    assert blind["eval/episode_reward"] == pytest.approx(-0.25, abs=0.05)
    seeing = small_run(env, policy_obs_key="privileged_state", **budget)
    assert last_evaluation(seeing.events())["eval/episode_reward"] > -0.05
    assert policy_from_checkpoint(seeing.checkpoint()).config.policy_obs_key == "privileged_state"
    assert np.asarray(FORMAT.read(seeing.checkpoint())[1]["normalizer"]["mean"]["state"]).shape == (1,)


def test_an_evaluation_and_a_policy_see_what_training_saw_where_nothing_is_normalised() -> None:
    # Training reads the sign as it is, and gets -0.25 without it; a bound of 1e-6 would hide it.
    options = {"normalize_observations": False, "normalize_observations_max_abs_value": 1e-6}
    run = small_run(probes.observed_action_reward(), entropy_cost=1e-2, **options)
    assert last_evaluation(run.events())["eval/episode_reward"] > -0.05
    assert policy_from_checkpoint(run.checkpoint()).config.normalize_observations_max_abs_value is None
