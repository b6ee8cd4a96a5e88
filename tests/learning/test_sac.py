"""SAC on the probes: each isolates one thing that a learner must do; the right answers are known."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.run import Run
from core.algorithms.sac.networks import make_networks
from core.algorithms.sac.policy import FORMAT
from core.algorithms.trained_policy import load_policy
from core.environments.rollout import Roller
from gaitway import policy as client_policy
from tests import probes
from tests.exports import numpy_file_of
from tests.learning.runs import checkpoints, last_evaluation
from tests.learning.sac_runs import STEPS_PER_UPDATE, sac_run, sac_settings

pytestmark = pytest.mark.usefixtures("compiled_for_longer_runs")


def value(run: Run[Any], observation: float, action: float = 0.0) -> float:
    """The mean of both critics."""
    params = FORMAT.read(run.checkpoint())[1]["params"]
    networks = make_networks(1, 1, sac_settings())
    seen, acted = jnp.array([[observation]]), jnp.array([[action]])
    return float(jnp.mean(networks.values(params["q"], seen, acted)))


def trained(environment: Any, **changes: Any) -> tuple[Run[Any], dict[str, float]]:
    run = sac_run(environment, **changes)
    return run, last_evaluation(run.events())


@pytest.mark.extra
def test_the_value_of_a_constant_reward_is_learnt() -> None:
    run, evaluation = trained(probes.constant_reward())
    assert evaluation["eval/episode_reward"] == 1.0
    assert value(run, 0.0) == pytest.approx(1.0, abs=0.05)


@pytest.mark.extra
def test_the_value_looks_at_the_observation() -> None:
    run, _ = trained(probes.observed_reward())
    assert value(run, 1.0) == pytest.approx(1.0, abs=0.05)
    assert value(run, -1.0) == pytest.approx(-1.0, abs=0.05)


@pytest.mark.extra
@pytest.mark.parametrize("n_step", [1, 3])
def test_a_reward_one_step_ahead_is_discounted_once(n_step: int) -> None:
    # 1 comes with the second of two steps: Q(0) = 0.5 · 1, Q(1) = 1.
    run, evaluation = trained(probes.delayed_reward(), n_step=n_step)
    assert evaluation["eval/avg_episode_length"] == 2.0
    assert value(run, 0.0) == pytest.approx(0.5, abs=0.05)
    assert value(run, 1.0) == pytest.approx(1.0, abs=0.05)


@pytest.mark.extra
def test_the_policy_finds_the_better_action() -> None:
    # The reward is minus the squared distance from 0.5; doing nothing gives -0.25.
    assert trained(probes.action_reward())[1]["eval/episode_reward"] > -0.01


def test_the_policy_looks_at_the_observation() -> None:
    # The best action is ±0.5, as the observation says; not looking at it gives -0.25 at best.
    assert trained(probes.observed_action_reward())[1]["eval/episode_reward"] > -0.02


@pytest.mark.extra
@pytest.mark.parametrize("n_step", [1, 3])
def test_a_cut_off_episode_does_not_count_as_an_end(n_step: int) -> None:
    # Every reward is 1 and nothing terminates: Q = 1 + 0.5 Q = 2. Were the cut after four steps an end,
    # it would be 1.875 on average over the steps at most.
    run, evaluation = trained(probes.unending_reward(), episode_length=4, n_step=n_step)
    assert evaluation["eval/avg_episode_length"] == 4.0
    assert value(run, 0.0) == pytest.approx(2.0, abs=0.05)


@pytest.mark.extra
def test_the_trained_policy_is_rolled_out_and_acts_alike_from_each_of_its_files(tmp_path: Path) -> None:
    probe = probes.observed_action_reward()
    run = sac_run(probe, normalize_observations=True)
    list(run.events())
    start = probe.reset(jax.random.key(1))
    for is_checkpoint, content in ((True, run.checkpoint()), (False, run.policy())):
        loaded = load_policy(content, "sac", is_checkpoint=is_checkpoint)
        shown, act = loaded.acting(probe)
        roller = Roller(shown, act)
        episodes = list(roller.episodes(loaded.parameters, jax.random.key(0), num_steps=4, num_episodes=8))
        assert len(episodes) == 8
        assert all(abs(float(episode.action[0, 0])) == pytest.approx(0.5, abs=0.15) for episode in episodes)
        assert all(episode.reward[0] > -0.02 for episode in episodes)
        (tmp_path / "file").write_bytes(content if is_checkpoint else numpy_file_of(content))
        asked = client_policy.load(tmp_path / "file", "sac", is_checkpoint=is_checkpoint)
        expected = act(loaded.parameters, start, jax.random.key(2))
        np.testing.assert_allclose(asked(start.obs), expected, rtol=1e-6)


@pytest.mark.extra
def test_a_checkpoint_holds_the_replay() -> None:
    # 2048 transitions of five numbers: an observation, an action, a reward, and how the step ended.
    budget = {"num_timesteps": 2 * STEPS_PER_UPDATE, "num_evals": 0}
    [content] = checkpoints(sac_run(probes.endless(), **budget)).values()
    kept = FORMAT.read(content)[1]["replay"]
    assert int(kept["written"]) == 8
    assert sum(array.nbytes for array in kept["rows"].values()) == 4 * 2048 * 5
    # Besides, the networks, Adam's moments, and 16 environments and their starts.
    assert len(content) < 4 * 2048 * 5 + 120_000
