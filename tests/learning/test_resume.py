"""A run's result depends on its settings and its seed, not on how it was cut into pieces."""

from collections.abc import Callable

import jax.numpy as jnp
import pytest

from core.algorithms.ppo.checkpoint import read
from core.algorithms.trainer import Progress
from core.environments import catalog, probes
from core.environments.environment import Environment
from core.errors import JobFailed
from core.physics.native import NativeEngine
from tests.learning.runs import STEPS_PER_UPDATE, checkpoints, small_trainer


def probe() -> Environment:
    return probes.observed_action_reward()


def ant() -> Environment:
    info = catalog.find("ant")
    return catalog.make(
        info, info.options(), lambda model, substeps, derived, **_: NativeEngine(model, substeps, derived)
    )


@pytest.mark.parametrize("environment", [probe, ant])
def test_a_resumed_run_equals_an_uninterrupted_one(environment: Callable[[], Environment]) -> None:
    # Six updates; kept after three and at the end. Short epochs first, one long one after the resumption.
    budget = {"num_timesteps": 6 * STEPS_PER_UPDATE, "episode_length": 5}
    straight = checkpoints(
        small_trainer(
            environment(), checkpoint_every_steps=3 * STEPS_PER_UPDATE, epoch_s=0.0, num_evals=2, **budget
        )
    )
    assert list(straight) == [3 * STEPS_PER_UPDATE, 6 * STEPS_PER_UPDATE]
    resumed = small_trainer(environment(), resume=straight[3 * STEPS_PER_UPDATE], num_evals=2, **budget)
    assert resumed.step == 3 * STEPS_PER_UPDATE
    assert checkpoints(resumed) == {6 * STEPS_PER_UPDATE: straight[6 * STEPS_PER_UPDATE]}


@pytest.mark.parametrize("reset_pool_size", [0, 3])
def test_fresh_starts_are_the_same_ones_however_a_run_is_cut(reset_pool_size: int) -> None:
    # Episodes of three actions end five times in an update of 16: every one begins at a random sign.
    budget = {
        "num_timesteps": 4 * STEPS_PER_UPDATE,
        "episode_length": 3,
        "reset_pool_size": reset_pool_size,
        "num_evals": 0,
    }
    world = probes.Probe(lambda obs, time, action: (action * obs, jnp.zeros(())), random_sign=True)
    straight = checkpoints(small_trainer(world, epoch_s=1000.0, **budget))
    stopped = small_trainer(world, epoch_s=0.0, **budget)
    next(event for event in stopped.events() if isinstance(event, Progress))
    resumed = small_trainer(world, resume=stopped.checkpoint(), **budget)
    assert checkpoints(resumed) == straight


def test_a_checkpoint_holds_first_states_only_where_a_run_goes_back_to_them() -> None:
    budget = {"num_timesteps": STEPS_PER_UPDATE, "num_evals": 0}
    drawn = checkpoints(small_trainer(probe(), **budget))[STEPS_PER_UPDATE]
    kept = checkpoints(small_trainer(probe(), reset_pool_size=0, **budget))[STEPS_PER_UPDATE]
    assert read(drawn)[1]["episodes"]["first"] is None
    assert read(kept)[1]["episodes"]["first"]["obs"].shape == (32, 1)
    with pytest.raises(JobFailed, match="returns_to_first_state is True in the checkpoint and False"):
        small_trainer(probe(), resume=kept, **budget)


def test_a_run_that_was_stopped_anywhere_goes_on_as_if_it_had_not() -> None:
    straight = checkpoints(small_trainer(probe(), num_timesteps=4 * STEPS_PER_UPDATE))
    stopped = small_trainer(probe(), num_timesteps=4 * STEPS_PER_UPDATE)
    next(event for event in stopped.events() if isinstance(event, Progress))
    assert stopped.step == STEPS_PER_UPDATE
    resumed = small_trainer(probe(), resume=stopped.checkpoint(), num_timesteps=4 * STEPS_PER_UPDATE)
    assert checkpoints(resumed) == straight


def test_the_partition_into_epochs_changes_nothing_and_the_seed_does() -> None:
    budget = {"num_timesteps": 5 * STEPS_PER_UPDATE, "num_evals": 0}
    one_by_one = checkpoints(small_trainer(probe(), epoch_s=0.0, **budget))
    all_at_once = checkpoints(small_trainer(probe(), epoch_s=1000.0, **budget))
    assert one_by_one == all_at_once
    assert checkpoints(small_trainer(probe(), seed=1, **budget)) != one_by_one


def test_a_finished_run_resumes_to_its_end_at_once() -> None:
    finished = checkpoints(small_trainer(probe(), num_timesteps=STEPS_PER_UPDATE))
    resumed = small_trainer(probe(), resume=finished[STEPS_PER_UPDATE], num_timesteps=STEPS_PER_UPDATE)
    assert checkpoints(resumed) == finished
