"""A run's result depends on its settings and its seed, not on how it was cut into pieces."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp
import pytest

from core.algorithms.events import TrainingProgress
from core.algorithms.ppo.learner import FORMAT
from core.algorithms.run import Run
from core.environments import catalog
from core.environments.environment import Environment
from core.errors import JobFailed
from core.physics.availability import EngineName
from core.physics.choose import engine_builder
from tests import probes
from tests.learning.dqn_runs import STEPS_PER_UPDATE as DQN_STEPS_PER_UPDATE
from tests.learning.dqn_runs import dqn_run
from tests.learning.q_probes import q_run, q_settings, two_rooms
from tests.learning.runs import (
    INTENTION,
    STEPS_PER_UPDATE,
    checkpoints,
    distillation_run,
    linear_expert,
    small_run,
)
from tests.learning.sac_runs import STEPS_PER_UPDATE as SAC_STEPS_PER_UPDATE
from tests.learning.sac_runs import sac_run


def probe() -> Environment:
    return probes.observed_action_reward()


def ant(engine: EngineName) -> Environment:
    info = catalog.find("ant")
    return catalog.make(info, info.options(), engine_builder(engine))


# Six updates of so many steps, with two evaluations, of each algorithm.
Begin = Callable[..., Run[Any]]


def ppo(environment: Callable[[], Environment], **options: Any) -> tuple[Begin, int]:
    budget = {"num_timesteps": 6 * STEPS_PER_UPDATE, "episode_length": 5, "num_evals": 2}
    return lambda **run: small_run(environment(), **budget, **options, **run), STEPS_PER_UPDATE


# The weight of the divergence rises in all six updates.
RAMPED = {**INTENTION, "kl_ramp_steps": 6 * STEPS_PER_UPDATE}


def q_learning(**options: Any) -> tuple[Begin, int]:
    """Rounds of an episode in 8 environments for each agent, of 6 decisions of 2 steps."""
    epsilon = {"start": 1.0, "end": 0.2, "decay_decisions": 200}
    budget = {"num_episodes": 48, "decision_steps": 2, "num_evals": 2, "epsilon": epsilon}
    settings = q_settings(**budget, **options)
    return lambda **run: q_run(two_rooms(), settings, **run), settings.env_steps_per_update


def sac(environment: Callable[[], Environment], **options: Any) -> tuple[Begin, int]:
    """It learns from the second update on, of targets that reach over what an earlier update wrote; the ring
    of 10 actions in each environment is full after the third and is written over in a resumed run."""
    budget = {"num_timesteps": 6 * SAC_STEPS_PER_UPDATE, "episode_length": 5, "num_evals": 2}
    kept = {"min_replay_size": 128, "max_replay_size": 160, "n_step": 3, "normalize_observations": True}
    return lambda **run: sac_run(environment(), **budget, **kept, **options, **run), SAC_STEPS_PER_UPDATE


def dqn(environment: Callable[[], Environment], **options: Any) -> tuple[Begin, int]:
    """As SAC's; epsilon falls until the fifth update."""
    budget = {"num_timesteps": 6 * DQN_STEPS_PER_UPDATE, "episode_length": 5, "num_evals": 2}
    kept = {"min_replay_size": 128, "max_replay_size": 160, "n_step": 3, "normalize_observations": True}
    kept |= {"epsilon": {"start": 1.0, "end": 0.1, "shape": "exponential", "decay_decisions": 256}}
    return lambda **run: dqn_run(environment(), **budget, **kept, **options, **run), DQN_STEPS_PER_UPDATE


def distillation(**options: Any) -> tuple[Begin, int]:
    """A student with an encoder; the teacher's share of the actions falls in the first four updates."""
    budget = {"num_timesteps": 6 * 128, "episode_length": 5, "num_evals": 2, "beta_steps": 4 * 128}
    teacher = linear_expert(0.5, 0.4)
    return lambda **run: distillation_run(probes.intention(), teacher, **budget, **options, **run), 128


REPLAYED: dict[str, Any] = {
    "agents": [{}, {"seed": 7, "learning_rate": 0.2}],
    "replay": {"buffer_size": 50, "batch_size": 4},
}


@pytest.mark.parametrize(
    ("begin", "update"),
    [
        pytest.param(*q_learning(**REPLAYED), id="q_learning-replay-agents"),
        pytest.param(*sac(probe), id="sac-probe"),
        pytest.param(*dqn(probe), id="dqn-probe"),
        pytest.param(*ppo(probes.intention, network=RAMPED), id="ppo-intention"),
        pytest.param(*distillation(network=RAMPED), id="distillation-intention"),
        pytest.param(*ppo(probe), id="ppo-probe", marks=pytest.mark.extra),
        pytest.param(*ppo(partial(ant, "native")), id="ppo-ant-native", marks=pytest.mark.extra),
        pytest.param(*ppo(partial(ant, "compiled")), id="ppo-ant-compiled", marks=pytest.mark.extra),
        pytest.param(*sac(probe, reset_pool_size=0), id="sac-first-states", marks=pytest.mark.extra),
        pytest.param(*sac(partial(ant, "native")), id="sac-ant-native", marks=pytest.mark.extra),
        pytest.param(*dqn(probe, reset_pool_size=0), id="dqn-first-states", marks=pytest.mark.extra),
    ],
)
def test_a_resumed_run_equals_an_uninterrupted_one(begin: Begin, update: int) -> None:
    # Kept after three updates and at the end. Short epochs first, one long one after the resumption.
    straight = checkpoints(begin(checkpoint_every_steps=3 * update, epoch_s=0.0))
    assert list(straight) == [3 * update, 6 * update]
    resumed = begin(resume=straight[3 * update])
    assert resumed.step == 3 * update
    assert checkpoints(resumed) == {6 * update: straight[6 * update]}


@pytest.mark.extra
@pytest.mark.parametrize("reset_pool_size", [0, 3])
def test_fresh_starts_are_the_same_ones_however_a_run_is_cut(reset_pool_size: int) -> None:
    # Episodes of three actions end five times in an update of 16: every one begins at a random sign.
    budget = {
        "num_timesteps": 4 * STEPS_PER_UPDATE,
        "episode_length": 3,
        "reset_pool_size": reset_pool_size,
        "num_evals": 0,
    }
    env = probes.Probe(lambda obs, time, action: (action * obs, jnp.zeros(())), random_sign=True)
    straight = checkpoints(small_run(env, epoch_s=1000.0, **budget))
    stopped = small_run(env, epoch_s=0.0, **budget)
    next(event for event in stopped.events() if isinstance(event, TrainingProgress))
    resumed = small_run(env, resume=stopped.checkpoint(), **budget)
    assert checkpoints(resumed) == straight


@pytest.mark.extra
def test_a_checkpoint_holds_first_states_only_where_a_run_goes_back_to_them() -> None:
    budget = {"num_timesteps": STEPS_PER_UPDATE, "num_evals": 0}
    drawn = checkpoints(small_run(probe(), **budget))[STEPS_PER_UPDATE]
    kept = checkpoints(small_run(probe(), reset_pool_size=0, **budget))[STEPS_PER_UPDATE]
    assert FORMAT.read(drawn)[1]["episodes"]["first"] is None
    assert FORMAT.read(kept)[1]["episodes"]["first"]["obs"].shape == (32, 1)
    with pytest.raises(JobFailed, match="returns_to_first_state is True in the checkpoint and False"):
        small_run(probe(), resume=kept, **budget)


@pytest.mark.extra
@pytest.mark.parametrize(
    ("begin", "update"),
    [ppo(probe), q_learning(**REPLAYED), sac(probe), dqn(probe)],
    ids=["ppo", "q_learning", "sac", "dqn"],
)
def test_a_run_that_was_stopped_anywhere_goes_on_as_if_it_had_not(begin: Begin, update: int) -> None:
    straight = checkpoints(begin())
    stopped = begin()
    next(event for event in stopped.events() if isinstance(event, TrainingProgress))
    assert stopped.step == update
    assert checkpoints(begin(resume=stopped.checkpoint())) == straight
    assert checkpoints(begin(seed=1)) != straight


@pytest.mark.extra
def test_the_partition_into_epochs_changes_nothing() -> None:
    budget = {"num_timesteps": 5 * STEPS_PER_UPDATE, "num_evals": 0}
    one_by_one = checkpoints(small_run(probe(), epoch_s=0.0, **budget))
    all_at_once = checkpoints(small_run(probe(), epoch_s=1000.0, **budget))
    assert one_by_one == all_at_once


@pytest.mark.extra
def test_a_finished_run_resumes_to_its_end_at_once() -> None:
    finished = checkpoints(small_run(probe(), num_timesteps=STEPS_PER_UPDATE))
    resumed = small_run(probe(), resume=finished[STEPS_PER_UPDATE], num_timesteps=STEPS_PER_UPDATE)
    assert checkpoints(resumed) == finished


@pytest.mark.extra
@pytest.mark.parametrize(
    ("begin", "update"), [(small_run, STEPS_PER_UPDATE), (sac_run, SAC_STEPS_PER_UPDATE)], ids=["ppo", "sac"]
)
def test_a_run_that_was_asked_for_less_and_resumes_is_the_longer_run(begin: Begin, update: int) -> None:
    """As `BaseSpec.trains_in_parts` promises: nothing in a run depends on its length."""
    whole = checkpoints(begin(probe(), num_timesteps=6 * update, num_evals=2))
    part = checkpoints(begin(probe(), num_timesteps=3 * update, num_evals=1))
    resumed = begin(probe(), num_timesteps=6 * update, num_evals=2, resume=part[3 * update])
    assert checkpoints(resumed) == whole
