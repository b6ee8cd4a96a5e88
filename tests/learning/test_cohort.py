"""Runs that are trained together: each as if it were alone, but for rounding."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import pytest

from core.algorithms.catalog import ALGORITHMS, loaded
from core.algorithms.checkpoint import Format
from core.algorithms.cohort import CohortRun
from core.algorithms.dqn.policy import FORMAT as DQN_FORMAT
from core.algorithms.events import CheckpointReady, Evaluated, Event, Progress
from core.algorithms.ppo.checkpoint import FORMAT as PPO_FORMAT
from core.algorithms.run import Run
from core.algorithms.sac.policy import FORMAT as SAC_FORMAT
from core.algorithms.spec import BaseSpec
from core.environments import catalog
from core.environments.environment import Environment
from core.errors import JobFailed
from core.physics.choose import engine_builder
from tests import probes
from tests.learning.dqn_runs import STEPS_PER_UPDATE as DQN_STEPS_PER_UPDATE
from tests.learning.dqn_runs import dqn_run, dqn_settings
from tests.learning.runs import STEPS_PER_UPDATE, small_run, small_settings
from tests.learning.sac_runs import STEPS_PER_UPDATE as SAC_STEPS_PER_UPDATE
from tests.learning.sac_runs import sac_run, sac_settings


@dataclass(frozen=True)
class Case:
    """An algorithm's small runs. update: environment steps."""

    settings: Callable[..., BaseSpec]
    begin: Callable[..., Run[Any]]
    update: int
    format: Format

    @property
    def budget(self) -> dict[str, Any]:
        """Six updates with an evaluation after the third and the last."""
        return {"num_timesteps": 6 * self.update, "num_evals": 2, "episode_length": 5}


PPO = Case(small_settings, small_run, STEPS_PER_UPDATE, PPO_FORMAT)
SAC = Case(sac_settings, sac_run, SAC_STEPS_PER_UPDATE, SAC_FORMAT)
DQN = Case(dqn_settings, dqn_run, DQN_STEPS_PER_UPDATE, DQN_FORMAT)
# The second differs from the first in its seed, the third in a number.
MEMBERS: list[dict[str, Any]] = [
    {"seed": 0, "learning_rate": 3e-3},
    {"seed": 1, "learning_rate": 3e-3},
    {"seed": 0, "learning_rate": 1e-3},
]


def cohort(case: Case, environment: Environment, members: list[dict[str, Any]]) -> CohortRun[Any]:
    algorithms = list[Any]()
    for member in members:
        changes = dict(member)
        seed, settings = changes.pop("seed"), case.settings(**{**case.budget, **changes})
        algorithm = loaded(ALGORITHMS[settings.algorithm()].algorithm)
        algorithms.append(algorithm(environment, settings, seed=seed, devices=1))
    return CohortRun(algorithms, checkpoint_every_steps=2 * case.update)


def seen_by_each(run: CohortRun[Any]) -> list[list[Event | JobFailed]]:
    """What each member sees, to the end."""
    seen: list[list[Event | JobFailed]] = [[] for _ in MEMBERS]
    for moment in run.moments():
        for member, what in moment:
            seen[member].append(what)
    return seen


def ant() -> Environment:
    info = catalog.find("ant")
    return catalog.make(info, info.options(), engine_builder("compiled"))


@pytest.mark.parametrize(
    ("case", "environment"),
    [
        (PPO, probes.observed_action_reward),
        (SAC, probes.observed_action_reward),
        (DQN, probes.endless),
        (PPO, ant),
    ],
    ids=["ppo", "sac", "dqn", "ppo-ant"],
)
def test_each_member_is_trained_as_it_would_be_alone(
    case: Case, environment: Callable[[], Environment]
) -> None:
    together = cohort(case, environment(), MEMBERS)
    seen = seen_by_each(together)
    for number, member in enumerate(MEMBERS):
        alone = case.begin(environment(), checkpoint_every_steps=2 * case.update, **member, **case.budget)
        events = list(alone.events())
        assert [type(one) for one in seen[number] if due(one)] == [type(one) for one in events if due(one)]
        for mine, its in zip(evaluations(seen[number]), evaluations(events), strict=True):
            assert mine.step == its.step
            assert mine.metrics["eval/episode_reward"] == pytest.approx(
                its.metrics["eval/episode_reward"], rel=1e-3, abs=1e-4
            )
        (_, mine), (_, its) = (
            case.format.read(run) for run in (together.checkpoint(number), alone.checkpoint())
        )
        for one, other in zip(jax.tree.leaves(mine), jax.tree.leaves(its), strict=True):
            assert (one.shape, one.dtype) == (other.shape, other.dtype)
            np.testing.assert_array_less(np.abs(one - other.astype(one.dtype)), 2e-2 + 1e-2 * np.abs(other))


def due(one: Event | JobFailed) -> bool:
    """Whether it comes at a step that the settings alone decide."""
    return not isinstance(one, Progress)


def evaluations(seen: list[Any]) -> list[Evaluated]:
    return [one for one in seen if isinstance(one, Evaluated)]


def test_a_member_goes_on_alone_from_its_checkpoint() -> None:
    together = cohort(PPO, probes.observed_action_reward(), MEMBERS)
    kept = b""
    for moment in together.moments():
        if any(isinstance(what, CheckpointReady) for _, what in moment) and not kept:
            kept = together.checkpoint(1)
    alone = small_run(probes.observed_action_reward(), seed=1, resume=kept, **PPO.budget)
    assert alone.step == 2 * PPO.update
    [last] = evaluations(list(alone.events()))[-1:]
    assert last.step == 6 * PPO.update


def test_a_member_that_diverges_costs_the_others_nothing() -> None:
    # A float32 ends at 3.4e38: the second member's scaled rewards are beyond it, the others' are 1 and 2.
    members = [{"seed": 0, "num_evals": 0, "reward_scaling": scale} for scale in (1e-33, 1e6, 2e-33)]
    together = cohort(PPO, probes.unending_reward(1e33), members)
    first, second, third = seen_by_each(together)
    assert isinstance(second[-1], JobFailed)
    assert second[-1].facts == {"step": PPO.update, "quantity": "policy loss"}
    assert together.failed == {1}
    assert together.step(1) == 0
    assert PPO_FORMAT.read(together.checkpoint(1))[0]["progress"]["step"] == 0
    assert first[-1] == third[-1] == CheckpointReady(6 * PPO.update)
