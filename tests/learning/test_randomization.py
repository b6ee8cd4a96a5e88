"""Environments that differ, in training: when their numbers change, and that runs stay what they are."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

from core.algorithms.events import TrainingProgress
from core.algorithms.ppo.learner import FORMAT
from core.algorithms.run import Run
from core.environments import catalog
from core.environments.environment import Environment
from core.environments.randomization import Randomization
from core.environments.wrappers.domain_randomization import randomize
from core.errors import JobFailed
from core.physics.native import NativeEngine
from tests import probes
from tests.learning.dqn_runs import STEPS_PER_UPDATE as DQN_STEPS_PER_UPDATE
from tests.learning.dqn_runs import dqn_run
from tests.learning.runs import STEPS_PER_UPDATE, checkpoints, small_run
from tests.learning.sac_runs import STEPS_PER_UPDATE as SAC_STEPS_PER_UPDATE
from tests.learning.sac_runs import sac_run

pytestmark = pytest.mark.extra

FALL = Randomization(field="opt.gravity", axis=2, range=(-12.0, -8.0), operation="set")
BUDGET = {"num_timesteps": 4 * STEPS_PER_UPDATE, "num_evals": 0}


def probe() -> Environment:
    """Nothing falls in it, but its environments have a gravity each."""
    return randomize(probes.endless(), [FALL])


def pendulum() -> Environment:
    info = catalog.find("inverted_pendulum")
    environment = catalog.make(
        info, info.options(), lambda model, substeps, derived, **_: NativeEngine(model, substeps, derived)
    )
    # A step takes 0.04 s.
    rules = [
        Randomization(field="body_mass", range=(0.5, 2.0)),
        Randomization(field="opt.gravity", axis=2, range=(0.8, 1.2), every_s=0.2),
    ]
    return randomize(environment, rules)


def gravities(checkpoint: bytes) -> Any:
    """Of every environment, downwards."""
    state = FORMAT.read(checkpoint)[1]["episodes"]["state"]
    return state["physics"]["model"]["opt.gravity"][:, 2]


def gravities_after_each_update(**changes: Any) -> list[Any]:
    run = small_run(probe(), epoch_s=0.0, **BUDGET, **changes)
    return [gravities(run.checkpoint()) for event in run.events() if isinstance(event, TrainingProgress)]


def drawn_with(seed: int) -> Any:
    states = jax.vmap(probe().reset)(jax.random.split(jax.random.PRNGKey(seed), 32))
    return np.asarray(states.physics.model["opt.gravity"][:, 2])


def test_environments_have_numbers_of_their_own_within_the_range() -> None:
    drawn = drawn_with(seed=0)
    assert drawn.min() >= -12.0
    assert drawn.max() <= -8.0
    assert len(np.unique(drawn)) > 20  # of 32 environments; two may take the same model


def test_equal_seeds_draw_alike_and_others_do_not() -> None:
    np.testing.assert_array_equal(drawn_with(seed=1), drawn_with(seed=1))
    assert not np.array_equal(drawn_with(seed=1), drawn_with(seed=2))


def test_an_environment_keeps_its_number_for_an_episode_and_draws_another_for_the_next() -> None:
    # An update has 16 steps. Episodes of 32 end in every second one; after that, the environments are others.
    first, second, third, fourth = gravities_after_each_update(episode_length=32)
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(second, third)
    assert not np.array_equal(third, fourth)


def test_without_a_pool_of_starts_an_environment_keeps_its_number_for_the_run() -> None:
    first, *later = gravities_after_each_update(episode_length=5, reset_pool_size=0)
    for drawn in later:
        np.testing.assert_array_equal(drawn, first)


@pytest.mark.parametrize(
    ("begin", "update"),
    [
        (small_run, STEPS_PER_UPDATE),
        (sac_run, SAC_STEPS_PER_UPDATE),
        (dqn_run, DQN_STEPS_PER_UPDATE),
    ],
    ids=["ppo", "sac", "dqn"],
)
def test_a_resumed_run_equals_an_uninterrupted_one(begin: Callable[..., Run[Any]], update: int) -> None:
    half = 4 * update
    budget = {"num_timesteps": 2 * half, "num_evals": 0}
    straight = checkpoints(begin(pendulum(), checkpoint_every_steps=half, **budget))
    resumed = begin(pendulum(), resume=straight[half], **budget)
    assert checkpoints(resumed) == {2 * half: straight[2 * half]}


def test_environments_that_do_not_differ_leave_nothing_in_a_checkpoint() -> None:
    run = small_run(probes.endless(), **BUDGET)
    next(event for event in run.events() if isinstance(event, TrainingProgress))
    plain = run.checkpoint()
    assert "model" not in FORMAT.read(plain)[1]["episodes"]["state"]["physics"]
    with pytest.raises(JobFailed, match=r"model\.opt\.gravity is missing in the checkpoint"):
        small_run(probe(), resume=plain, **BUDGET)
