"""An algorithm that the project does not have, from its own folder and one row of the catalog."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import pytest

from core.algorithms.catalog import ALGORITHMS, AlgorithmInfo
from core.algorithms.run import Run, make_run
from core.algorithms.trained_policy import load_policy, policy_from_checkpoint
from core.errors import JobFailed
from tests import probes
from tests.learning.random_search.spec import RandomSearchSpec
from tests.learning.runs import checkpoints, last_evaluation

_FOLDER = "tests.learning.random_search.algorithm"
_UPDATES = 40
_SETTINGS = RandomSearchSpec(num_timesteps=_UPDATES * 16, episode_length=1, learning_rate=1.0)


@pytest.fixture(autouse=True)
def row(monkeypatch: pytest.MonkeyPatch) -> None:
    info = AlgorithmInfo(RandomSearchSpec, f"{_FOLDER}:RandomSearch", f"{_FOLDER}:load")
    monkeypatch.setitem(ALGORITHMS, "random_search", info)


def begin(resume: bytes | None = None) -> Run[Any]:
    return make_run(
        probes.observed_action_reward(),
        _SETTINGS,
        seed=0,
        checkpoint_every_steps=20 * 16,
        resume=resume,
        epoch_s=0,
    )


def test_it_is_written_in_under_150_lines() -> None:
    files = (Path(__file__).parent / "random_search").glob("*.py")
    assert sum(len(file.read_text().splitlines()) for file in files) < 150


def test_it_learns_and_its_policy_acts() -> None:
    run = begin()
    # The best action is half the observation: a weight of 0.5, and then a reward of 0.
    assert last_evaluation(run.events())["eval/episode_reward"] == pytest.approx(0.0, abs=1e-3)
    for policy in (
        load_policy(run.policy(), "random_search", is_checkpoint=False),
        policy_from_checkpoint(run.checkpoint()),
    ):
        environment, act = policy.acting(probes.observed_action_reward())
        state = replace(environment.reset(jax.random.PRNGKey(0)), obs=jnp.array([1.0]))
        action = act(policy.parameters, state, jax.random.PRNGKey(0))
        assert float(action[0]) == pytest.approx(0.5, abs=0.02)


def test_a_run_that_resumes_ends_as_one_that_was_not_interrupted() -> None:
    whole = checkpoints(begin())
    half, end = whole[20 * 16], whole[40 * 16]
    assert checkpoints(begin(half))[40 * 16] == end


def test_a_run_that_diverges_says_where() -> None:
    run = make_run(
        probes.exploding(after=4),
        _SETTINGS.model_copy(update={"episode_length": 8}),
        seed=0,
        checkpoint_every_steps=None,
    )
    with pytest.raises(JobFailed, match="The return became non-finite at environment step 128"):
        list(run.events())
    assert run.step == 0
