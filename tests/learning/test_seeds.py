"""Seeds that one run trains side by side: each as its own run would train it, but for rounding."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.checkpoint import Format, of_seed
from core.algorithms.dqn.policy import FORMAT as DQN_FORMAT
from core.algorithms.events import (
    CheckpointReady,
    Evaluated,
    Event,
    SeedDiverged,
    TrainingProgress,
    is_of_a_seed,
    metric_of_seed,
)
from core.algorithms.ppo.learner import FORMAT as PPO_FORMAT
from core.algorithms.run import Run
from core.algorithms.sac.policy import FORMAT as SAC_FORMAT
from core.algorithms.seeds import SeedsRun, make_seeds_run
from core.algorithms.spec import BaseSpec
from core.algorithms.trained_policy import policy_from_checkpoint
from core.environments import catalog
from core.environments.environment import Environment, State
from core.errors import JobFailed, Rejected
from core.physics.choose import engine_builder
from core.physics.engine import NOMINAL, ModelFields
from core.reasons import Reason
from tests import probes
from tests.learning.dqn_runs import STEPS_PER_UPDATE as DQN_STEPS_PER_UPDATE
from tests.learning.dqn_runs import dqn_run, dqn_settings
from tests.learning.q_probes import q_settings
from tests.learning.runs import INTENTION, STEPS_PER_UPDATE, small_run, small_settings
from tests.learning.sac_runs import STEPS_PER_UPDATE as SAC_STEPS_PER_UPDATE
from tests.learning.sac_runs import sac_run, sac_settings

RETURN = "eval/episode_reward"


@dataclass(frozen=True)
class Case:
    """An algorithm's small runs. update: environment steps."""

    settings: Callable[..., BaseSpec]
    begin: Callable[..., Run[Any]]
    update: int
    format: Format
    num_updates: int = 6

    @property
    def budget(self) -> dict[str, Any]:
        """The updates, with an evaluation in the middle and after the last."""
        return {"num_timesteps": self.num_updates * self.update, "num_evals": 2, "episode_length": 5}


PPO = Case(small_settings, small_run, STEPS_PER_UPDATE, PPO_FORMAT)
SAC = Case(sac_settings, sac_run, SAC_STEPS_PER_UPDATE, SAC_FORMAT)
DQN = Case(dqn_settings, dqn_run, DQN_STEPS_PER_UPDATE, DQN_FORMAT)
PPO_OF_INTENTIONS = replace(
    PPO,
    settings=partial(small_settings, network=INTENTION),
    begin=partial(small_run, network=INTENTION),
    num_updates=2,  # Rounding grows faster with two networks in a row.
)
SEEDS = [0, 3, 1]


def seeds_run(
    case: Case,
    environment: Environment,
    seeds: Sequence[int] = SEEDS,
    resume: bytes | None = None,
    **changes: Any,
) -> SeedsRun[Any]:
    settings = case.settings(**{**case.budget, **changes})
    return make_seeds_run(
        environment, settings, seeds=seeds, checkpoint_every_steps=2 * case.update, resume=resume
    )


def ant(engine: Any) -> Environment:
    info = catalog.find("ant")
    return catalog.make(info, info.options(), engine_builder(engine))


@pytest.mark.extra
@pytest.mark.parametrize(
    ("case", "environment"),
    [
        (PPO, probes.observed_action_reward),
        (SAC, probes.observed_action_reward),
        (DQN, probes.endless),
        (PPO, lambda: ant("compiled")),
        (PPO, lambda: ant("native")),
        (PPO_OF_INTENTIONS, probes.intention),
    ],
    ids=["ppo", "sac", "dqn", "ppo-compiled", "ppo-native", "ppo-intention"],
)
def test_each_seed_is_trained_as_it_would_be_alone(
    case: Case, environment: Callable[[], Environment]
) -> None:
    together = seeds_run(case, environment())
    events = list(together.events())
    checkpoint = together.checkpoint()
    for seed in SEEDS:
        alone = case.begin(environment(), checkpoint_every_steps=2 * case.update, seed=seed, **case.budget)
        its_events = list(alone.events())
        assert [type(one) for one in events if is_due(one)] == [
            type(one) for one in its_events if is_due(one)
        ]
        for mine, its in zip(evaluations(events), evaluations(its_events), strict=True):
            assert mine.step == its.step
            own = mine.metrics[metric_of_seed(seed, RETURN)]
            assert own == pytest.approx(its.metrics[RETURN], rel=1e-3, abs=1e-4)
        (_, mine), (_, its) = (
            case.format.read(content) for content in (of_seed(checkpoint, seed), alone.checkpoint())
        )
        for one, other in zip(jax.tree.leaves(mine), jax.tree.leaves(its), strict=True):
            assert (one.shape, one.dtype) == (other.shape, other.dtype)
            np.testing.assert_array_less(np.abs(one - other.astype(one.dtype)), 2e-2 + 1e-2 * np.abs(other))


def is_due(one: Event) -> bool:
    """Whether it comes at a step that the settings alone decide."""
    return not isinstance(one, TrainingProgress)


def evaluations(events: Sequence[Event]) -> list[Evaluated]:
    return [one for one in events if isinstance(one, Evaluated)]


@pytest.mark.extra
def test_a_metric_is_the_mean_over_the_seeds() -> None:
    for event in seeds_run(PPO, probes.observed_action_reward()).events():
        if isinstance(event, Evaluated):
            own = [event.metrics[metric_of_seed(seed, RETURN)] for seed in SEEDS]
            assert event.metrics[RETURN] == pytest.approx(sum(own) / 3)
            assert len(set(own)) == 3


@pytest.mark.parametrize(
    ("case", "environment"),
    [
        pytest.param(PPO, probes.observed_action_reward, id="ppo"),
        pytest.param(PPO, lambda: ant("compiled"), id="ppo-compiled", marks=pytest.mark.extra),
        pytest.param(SAC, probes.observed_action_reward, id="sac", marks=pytest.mark.extra),
        pytest.param(DQN, probes.endless, id="dqn", marks=pytest.mark.extra),
    ],
)
def test_a_resumed_run_ends_in_the_bytes_of_an_uninterrupted_one(
    case: Case, environment: Callable[[], Environment]
) -> None:
    whole = seeds_run(case, environment())
    kept = b""
    for event in whole.events():
        if isinstance(event, CheckpointReady) and not kept:
            kept = whole.checkpoint()
    resumed = seeds_run(case, environment(), resume=kept)
    assert resumed.step == 2 * case.update
    assert resumed.checkpoint() == kept
    list(resumed.events())
    assert resumed.checkpoint() == whole.checkpoint()
    assert [resumed.policy(seed) for seed in SEEDS] == [whole.policy(seed) for seed in SEEDS]


@pytest.mark.extra
def test_a_seeds_policy_is_the_one_in_its_part_of_the_checkpoint() -> None:
    run = seeds_run(PPO, probes.observed_action_reward())
    list(run.events())
    parameters = [policy_from_checkpoint(run.checkpoint(), seed=seed).parameters for seed in SEEDS]
    leaves = [np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(one)]) for one in parameters]
    assert not np.array_equal(leaves[0], leaves[1])
    with pytest.raises(JobFailed, match=r"no seed 7; it has \[0, 3, 1\]"):
        of_seed(run.checkpoint(), 7)


@pytest.mark.extra
def test_a_checkpoint_is_for_the_same_seeds_alone() -> None:
    run, alone = seeds_run(PPO, probes.endless()), small_run(probes.endless(), **PPO.budget)
    for one in (run, alone):
        next(event for event in one.events() if isinstance(event, TrainingProgress))
    with pytest.raises(JobFailed, match=r"seeds is \[0, 3, 1\] in the checkpoint and \[0, 1\] in this job"):
        seeds_run(PPO, probes.endless(), seeds=[0, 1], resume=run.checkpoint())
    with pytest.raises(JobFailed, match=r"seeds is \[0, 3, 1\] in the checkpoint and None in this job"):
        small_run(probes.endless(), resume=run.checkpoint(), **PPO.budget)
    with pytest.raises(JobFailed, match=r"seeds is None in the checkpoint and \[0, 3, 1\] in this job"):
        seeds_run(PPO, probes.endless(), resume=alone.checkpoint())


def test_tables_are_not_trained_with_several_seeds() -> None:
    settings = q_settings()
    with pytest.raises(Rejected, match="its `agents` learn side by side already") as refused:
        make_seeds_run(probes.endless(), settings, seeds=SEEDS, checkpoint_every_steps=None)
    assert [problem.pointer for problem in refused.value.problems] == ["/seeds"]


class Unlucky(probes.Probe):
    """Each episode observes one number between 0 and 1; above the bound, its rewards are no numbers."""

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        return replace(super().reset(key, model), obs=jax.random.uniform(key, (1,)))


def unlucky(above: float = 0.999) -> Environment:
    return Unlucky(lambda obs, _, __: (jnp.where(obs > above, jnp.nan, obs), jnp.zeros(())))


# A seed has some 600 episodes, and one in a thousand is bad: 7 meets it soon, 4 later, and 0 never.
MANY = [0, 4, 7]


@dataclass(frozen=True)
class Ended:
    """A run of these seeds, its events, and its checkpoints by step."""

    run: SeedsRun[Any]
    events: list[Event]
    checkpoints: dict[int, bytes]

    @property
    def told(self) -> dict[int, SeedDiverged]:
        return {event.seed: event for event in self.events if isinstance(event, SeedDiverged)}


@pytest.fixture(scope="module")
def ended() -> Ended:
    run = seeds_run(PPO, unlucky(), MANY, num_evals=0)
    events, checkpoints = list[Event](), dict[int, bytes]()
    for event in run.events():
        events.append(event)
        if isinstance(event, CheckpointReady):
            checkpoints[event.step] = run.checkpoint()
    return Ended(run, events, checkpoints)


@pytest.mark.extra
@pytest.mark.parametrize("seed", [0, 7])
def test_a_seed_that_diverges_ends_as_its_own_run_and_costs_the_others_nothing(
    ended: Ended, seed: int
) -> None:
    alone, told = small_run(unlucky(), seed=seed, **{**PPO.budget, "num_evals": 0}), ended.told
    if seed in told:
        with pytest.raises(JobFailed) as failed:
            list(alone.events())
        assert failed.value.facts == {"step": told[seed].step, "quantity": told[seed].quantity}
        assert failed.value.detail == told[seed].detail
    else:
        list(alone.events())
    assert ended.run.step_of(seed) == alone.step
    (_, mine), (_, its) = (
        PPO_FORMAT.read(content) for content in (of_seed(ended.run.checkpoint(), seed), alone.checkpoint())
    )
    for one, other in zip(jax.tree.leaves(mine), jax.tree.leaves(its), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-2, atol=2e-2)


@pytest.mark.extra
def test_the_metrics_of_a_seed_that_has_diverged_end(ended: Ended) -> None:
    assert [event.seed for event in ended.events if isinstance(event, SeedDiverged)] == [7, 4]
    assert ended.events[-1] == CheckpointReady(ended.run.total)
    for event in ended.events:
        if isinstance(event, TrainingProgress):
            own = {
                int(name.split("/")[0].removeprefix("seed_")) for name in event.metrics if is_of_a_seed(name)
            }
            assert own == {
                seed for seed in MANY if seed not in ended.told or event.step < ended.told[seed].step
            }
            assert all(np.isfinite(value) for value in event.metrics.values())


@pytest.mark.extra
def test_a_seed_that_has_diverged_stays_so_when_the_run_resumes(ended: Ended) -> None:
    step = 2 * PPO.update
    assert ended.told[7].step < step < ended.told[4].step
    resumed = seeds_run(PPO, unlucky(), MANY, resume=ended.checkpoints[step], num_evals=0)
    again = [event for event in resumed.events() if isinstance(event, SeedDiverged)]
    assert again == [ended.told[4]]
    assert resumed.checkpoint() == ended.run.checkpoint()


@pytest.mark.extra
def test_a_run_whose_seeds_all_diverge_has_diverged() -> None:
    run = seeds_run(PPO, unlucky(above=0.0), num_evals=0)
    events = list[Event]()
    with pytest.raises(JobFailed, match="Every seed has diverged, seed 1 as the last: The ") as failed:
        events.extend(run.events())
    assert failed.value.reason == Reason.DIVERGED
    assert [event.seed for event in events if isinstance(event, SeedDiverged)] == SEEDS
    assert run.step == 0
    with pytest.raises(JobFailed, match="Every seed of the checkpoint has diverged"):
        seeds_run(PPO, unlucky(), resume=run.checkpoint(), num_evals=0)
