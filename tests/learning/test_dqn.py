"""What a deep Q-network learns, where the right answer is known."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.dqn.network import QNetwork
from core.algorithms.dqn.policy import FORMAT
from core.algorithms.events import TrainingProgress
from core.algorithms.q_learning.discrete_env import make_action_set
from core.algorithms.run import Run
from core.algorithms.trained_policy import load_policy
from core.environments.rollout import Roller
from core.errors import JobFailed, Rejected
from gaitway import policy as client_policy
from tests import probes
from tests.learning.dqn_runs import STEPS_PER_UPDATE, dqn_run, dqn_settings
from tests.learning.q_probes import PlanarStar, two_rooms
from tests.learning.runs import checkpoints, last_evaluation

TWO = {"kind": "actions", "actions": [[-1.0], [1.0]]}


def values(run: Run[Any], environment: Any, *observations: float, **changes: Any) -> np.ndarray:
    """The value of each choice at each observation, [observations, choices]."""
    settings = dqn_settings(**changes)
    assert settings.action_set is not None
    action_set = make_action_set(settings.action_set, environment)
    sizes = tuple(settings.hidden_layer_sizes)
    network = QNetwork(action_set.num_parts, action_set.num_choices, sizes, settings.activation)
    params = FORMAT.read(run.checkpoint())[1]["params"]
    return np.asarray(network.values(params, jnp.array(observations)[:, None])[:, 0])


def trained(environment: Any, **changes: Any) -> tuple[Run[Any], dict[str, float]]:
    run = dqn_run(environment, **changes)
    return run, last_evaluation(run.events())


@pytest.mark.extra
def test_a_known_optimum_is_found_as_by_the_table() -> None:
    # In room 1 the end brings 2, in room 0 the way there 0.5 · 2 = 1; staying is worth 0.4 + 0.5 · 1, going
    # back 0.5 · 1.
    run, evaluation = trained(two_rooms(), action_set=TWO)
    assert evaluation["eval/episode_reward"] == pytest.approx(2.0)
    assert evaluation["eval/avg_episode_length"] == 2.0
    found = values(run, two_rooms(), 0.0, 1.0, action_set=TWO)
    np.testing.assert_allclose(found, [[0.9, 1.0], [0.5, 2.0]], atol=0.05)


def test_the_choice_looks_at_the_observation() -> None:
    # The best action is ±0.5, as the observation says, for 0; the middle one gives -0.25, the other -1.
    run, evaluation = trained(probes.observed_action_reward())
    assert evaluation["eval/episode_reward"] == 0.0
    found = values(run, probes.observed_action_reward(), -1.0, 1.0)
    np.testing.assert_allclose(found, [[0.0, -0.25, -1.0], [-1.0, -0.25, 0.0]], atol=0.05)


@pytest.mark.extra
def test_a_cut_off_episode_does_not_count_as_an_end() -> None:
    # Every reward is 1 and nothing terminates: Q = 1 + 0.5 Q = 2.
    run, evaluation = trained(probes.unending_reward(), episode_length=4)
    assert evaluation["eval/avg_episode_length"] == 4.0
    np.testing.assert_allclose(values(run, probes.unending_reward(), 0.0), 2.0, atol=0.05)


def test_epsilon_falls_over_its_decisions_and_then_stays() -> None:
    # Updates of 64 decisions: from 1 to 0.5 over 128 of them it is 1, 0.75, and then 0.5.
    epsilon = {"start": 1.0, "end": 0.5, "decay_decisions": 128}
    run = dqn_run(
        probes.endless(), epsilon=epsilon, num_timesteps=4 * STEPS_PER_UPDATE, num_evals=0, epoch_s=0.0
    )
    told = [
        event.metrics["training/epsilon"] for event in run.events() if isinstance(event, TrainingProgress)
    ]
    assert told == [1.0, 0.75, 0.5, 0.5]


@dataclass(frozen=True)
class SeeingStar(PlanarStar):
    """It observes, for each arm, how far that points towards the target: a cosine."""

    observation_size: int = 5

    def reset(self, key: jax.Array, *model: Any) -> Any:
        return self._seeing(super().reset(key, *model))

    def step(self, state: Any, action: jax.Array) -> Any:
        return self._seeing(super().step(state, action))

    def _seeing(self, state: Any) -> Any:
        info = state.info
        x, y = info["xy_direction_to_target"]
        arms = 2 * jnp.pi * jnp.arange(self.num_arms) / self.num_arms + info["disk_rotation"][2]
        return replace(state, obs=x * jnp.cos(arms) + y * jnp.sin(arms))


ARMS = {
    "action_set": {"kind": "arm_actions", "actions": [[0.0], [1.0]]},
    "episode_length": 100,
    "action_repeat": 5,
    "reward_scaling": 10.0,
}


@pytest.mark.extra
def test_arms_choose_for_themselves_by_one_network(tmp_path: Path) -> None:
    star = SeeingStar(speed=0.5)
    run, evaluation = trained(star, **ARMS, num_timesteps=150 * 5 * STEPS_PER_UPDATE)
    # From 1 m to within 0.2 m.
    assert evaluation["eval/episode_reward"] >= 0.75
    # The arm that points to the target pulls, and those that point away do not.
    policy = load_policy(run.policy(), "dqn", is_checkpoint=False)
    environment, act = policy.acting(star)
    [episode] = Roller(environment, act).episodes(
        policy.parameters, jax.random.key(0), num_steps=100, num_episodes=1
    )
    assert episode.terminated
    assert episode.action.shape[1] == 5
    changes = np.flatnonzero((episode.action[1:] != episode.action[:-1]).any(axis=1)) + 1
    assert (changes % 5 == 0).all()  # Each choice is held for five steps.
    (tmp_path / "policy").write_bytes(run.policy())
    choose = client_policy.load(tmp_path / "policy", "dqn", is_checkpoint=False)
    seen = jnp.cos(2 * jnp.pi * jnp.arange(5) / 5)
    assert choose(seen).tolist() == [1, 1, 0, 0, 1]
    with pytest.raises(JobFailed, match=r"= \[5, 5, 2\], and this environment needs \[7, 5, 2\]"):
        policy.acting(SeeingStar(observation_size=7))


@pytest.mark.extra
def test_the_trained_policy_acts_alike_from_each_of_its_files_and_with_noise(tmp_path: Path) -> None:
    probe = probes.observed_action_reward()
    run = dqn_run(probe, normalize_observations=True, epsilon={"start": 1.0, "end": 1.0})
    list(run.events())
    for is_checkpoint, content in ((True, run.checkpoint()), (False, run.policy())):
        loaded = load_policy(content, "dqn", is_checkpoint=is_checkpoint)
        shown, act = loaded.acting(probe)
        roller = Roller(shown, act)
        episodes = list(roller.episodes(loaded.parameters, jax.random.key(0), num_steps=4, num_episodes=8))
        assert all(episode.reward[0] == 0.0 for episode in episodes)
        noisy = load_policy(content, "dqn", is_checkpoint=is_checkpoint, deterministic=False)
        roller = Roller(*noisy.acting(probe))
        episodes = list(roller.episodes(noisy.parameters, jax.random.key(0), num_steps=1, num_episodes=32))
        assert len({float(episode.action[0, 0]) for episode in episodes}) == 3
        (tmp_path / "file").write_bytes(content)
        asked = client_policy.load(tmp_path / "file", "dqn", is_checkpoint=is_checkpoint)
        assert [int(asked(jnp.array([sign]))[0]) for sign in (-1.0, 1.0)] == [0, 2]


@pytest.mark.extra
def test_a_checkpoint_holds_the_replay() -> None:
    # 2048 transitions of five numbers: an observation, a choice, a reward, and how the step ended.
    budget = {"num_timesteps": 2 * STEPS_PER_UPDATE, "num_evals": 0}
    [content] = checkpoints(dqn_run(probes.endless(), **budget)).values()
    kept = FORMAT.read(content)[1]["replay"]
    assert int(kept["written"]) == 8
    assert sum(array.nbytes for array in kept["rows"].values()) == 4 * 2048 * 5


@pytest.mark.extra
def test_a_checkpoint_of_other_choices_is_refused() -> None:
    budget = {"num_timesteps": 2 * STEPS_PER_UPDATE, "num_evals": 0}
    [content] = checkpoints(dqn_run(probes.endless(), **budget)).values()
    with pytest.raises(JobFailed, match="action_set is") as failure:
        dqn_run(probes.endless(), **budget, action_set=TWO, resume=content)
    assert failure.value.reason == "bad_checkpoint"


def test_without_choices_there_is_no_run() -> None:
    with pytest.raises(Rejected, match="needs an `action_set`"):
        dqn_run(probes.endless(), action_set=None)
