"""What a run tells while it goes on, and how it ends when values are not finite."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import pytest

from core.algorithms.checkpoint import Format
from core.algorithms.dqn.policy import FORMAT as DQN_FORMAT
from core.algorithms.events import BodyLost, CheckpointReady, Evaluated, Event, Phase, TrainingProgress
from core.algorithms.ppo.learner import FORMAT as PPO_FORMAT
from core.algorithms.run import Run
from core.algorithms.sac.policy import FORMAT as SAC_FORMAT
from core.errors import JobFailed
from tests import probes
from tests.extra import extra
from tests.learning.dqn_runs import STEPS_PER_UPDATE as DQN_STEPS_PER_UPDATE
from tests.learning.dqn_runs import dqn_run
from tests.learning.runs import STEPS_PER_UPDATE, small_run
from tests.learning.sac_runs import STEPS_PER_UPDATE as SAC_STEPS_PER_UPDATE
from tests.learning.sac_runs import sac_run


@dataclass(frozen=True)
class Case:
    """An algorithm's small runs. update: environment steps."""

    begin: Callable[..., Run[Any]]
    update: int
    num_envs: int
    format: Format


@pytest.fixture(
    params=[
        Case(small_run, STEPS_PER_UPDATE, 32, PPO_FORMAT),
        *extra(
            Case(sac_run, SAC_STEPS_PER_UPDATE, 16, SAC_FORMAT),
            Case(dqn_run, DQN_STEPS_PER_UPDATE, 16, DQN_FORMAT),
        ),
    ],
    ids=["ppo", "sac", "dqn"],
)
def case(request: pytest.FixtureRequest) -> Case:
    return request.param


def names(events: list[Event], update: int) -> list[str]:
    """Events as words, in their order, with the number of the update."""
    return [
        f"phase {event.name}"
        if isinstance(event, Phase)
        else f"{type(event).__name__} {event.step / update:g}"
        for event in events
    ]


def test_events_come_in_their_order_and_nothing_compiles_after_the_start(case: Case) -> None:
    compilations = list[str]()

    def note(event: str, duration: float, **_: object) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            compilations.append(event)

    jax.monitoring.register_event_duration_secs_listener(note)
    # Six updates: evaluations after 3 and 6, checkpoints at 1.95 updates (2), 3.9 (4), 5.85 (6).
    run = case.begin(
        probes.endless(),
        num_timesteps=6 * case.update,
        num_evals=2,
        checkpoint_every_steps=125 * case.update // 64,
        epoch_s=1000.0,
    )
    events = list[Event]()
    compiled_at_start = 0
    for event in run.events():
        if isinstance(event, Phase) and event.name == "compile":
            compiled_at_start = len(compilations)
        if isinstance(event, CheckpointReady):
            assert case.format.read(run.checkpoint())[0]["progress"]["step"] == event.step
        events.append(event)
    assert names(events, case.update) == [
        "phase trace",
        "phase compile",
        "phase first_update",
        "TrainingProgress 1",
        "TrainingProgress 2",
        "CheckpointReady 2",
        "TrainingProgress 3",
        "Evaluating 3",
        "Evaluated 3",
        "TrainingProgress 4",
        "CheckpointReady 4",
        "TrainingProgress 6",
        "Evaluating 6",
        "Evaluated 6",
        "CheckpointReady 6",
    ]
    assert compiled_at_start > 0
    assert len(compilations) == compiled_at_start

    progress = [event for event in events if isinstance(event, TrainingProgress)][-1]
    assert progress.total == 6 * case.update
    # The action is both the reward and the speed of this probe, and an episode has 8 steps.
    assert progress.metrics["training/episode_length"] == 8.0
    assert progress.metrics["training/fall_rate"] == 0.0
    assert progress.metrics["training/sps"] > 0
    evaluation = [event for event in events if isinstance(event, Evaluated)][-1]
    assert evaluation.metrics["eval/forward_speed"] == pytest.approx(
        evaluation.metrics["eval/episode_reward"] / 8, rel=1e-5
    )
    evaluations = [event.metrics for event in events if isinstance(event, Evaluated)]
    evaluating = sum(metrics["eval/epoch_eval_time"] for metrics in evaluations)
    training = progress.metrics["training/walltime"]
    assert evaluations[-1]["eval/walltime"] == pytest.approx(evaluating)
    assert evaluations[-1]["eval/walltime_share"] == pytest.approx(evaluating / (evaluating + training))


def test_a_run_that_diverges_names_step_and_quantity_and_keeps_the_last_good_state(case: Case) -> None:
    # The reward breaks with an episode's 42nd step. PPO's update has 16 steps of 32 environments, so this is
    # time step 9 of the third update: environment step 2 · 512 + 9 · 32 = 1312. SAC's and DQN's have 4 steps
    # of 16 environments: time step 1 of the eleventh, environment step 10 · 64 + 16 = 656.
    step = 41 * case.num_envs
    before = step // case.update * case.update
    run = case.begin(probes.exploding(after=41), episode_length=1000, epoch_s=1000.0)
    with pytest.raises(JobFailed, match=f"reward became non-finite at environment step {step}") as failure:
        list(run.events())
    assert failure.value.reason == "diverged"
    assert failure.value.facts == {"step": step, "quantity": "reward"}
    assert run.step == before
    header, state = case.format.read(run.checkpoint())
    assert header["progress"]["step"] == before
    assert all(jax.numpy.isfinite(leaf).all() for leaf in jax.tree.leaves(state["params"]))


def test_a_body_that_is_lost_ends_its_episode_and_not_the_run() -> None:
    # Two of the first 32 bodies have a number below 0.04, and are lost in the second update.
    run = small_run(probes.losing(share=0.04, after=20), episode_length=1000, epoch_s=0.0)
    events = list(run.events())
    told = [event.metrics for event in events if isinstance(event, TrainingProgress)]
    assert [metrics["training/lost_bodies"] for metrics in told[:3]] == [0.0, 2 / STEPS_PER_UPDATE, 0.0]
    # One of them is told of, before the update's metrics: its 21st action is the update's 5th.
    [lost] = [event for event in events if isinstance(event, BodyLost)]
    assert isinstance(before := events[events.index(lost) + 1], TrainingProgress)
    assert before.step == 2 * STEPS_PER_UPDATE
    assert lost.step == STEPS_PER_UPDATE + 4 * 32
    assert lost.steps.reward.tolist() == [1.0, 1.0, 1.0, 1.0, 0.0]
    assert lost.steps.action.shape == (5, 1)
    assert len(told) == 20_480 / STEPS_PER_UPDATE
    assert all(math.isfinite(value) for metrics in told for value in metrics.values())


@pytest.mark.extra
def test_a_run_that_loses_every_body_has_diverged(case: Case) -> None:
    step = 5 * case.num_envs
    run = case.begin(probes.losing(share=1.0, after=5), episode_length=1000, epoch_s=1000.0)
    told: list[Event] = []
    with pytest.raises(JobFailed, match=f"observation became non-finite at environment step {step}"):
        told.extend(run.events())
    assert run.step == step // case.update * case.update
    # All are lost by their 6th action; the first one's is told of, though its update is not kept.
    assert isinstance(told[-1], BodyLost)
    assert (told[-1].step, told[-1].env) == (step, 0)


@pytest.mark.extra
def test_a_loss_that_overflows_is_told_from_a_reward_that_does() -> None:
    # 1e38 is a float32, and 1e6 times it is none: the rewards are finite and the loss is not.
    run = small_run(probes.unending_reward(1e38), reward_scaling=1e6)
    with pytest.raises(JobFailed, match="policy loss became non-finite at environment step 512") as failure:
        list(run.events())
    assert failure.value.facts == {"step": STEPS_PER_UPDATE, "quantity": "policy loss"}
    assert run.step == 0


@pytest.mark.extra
def test_a_second_evaluation_has_other_starts_and_changes_nothing(case: Case) -> None:
    """The probe's reward is what an episode's start drew."""
    budget = {"num_timesteps": 4 * case.update, "num_evals": 1}
    runs = [case.begin(probes.observed_reward(), **budget) for _ in range(2)]
    seen = list[float]()
    for event in runs[0].events():
        if isinstance(event, Evaluated):
            values = [runs[0].evaluate(seed)["eval/episode_reward"] for seed in (1, 1, 2)]
            seen = [event.metrics["eval/episode_reward"], *values]
    assert seen[1] == seen[2]
    assert len(set(seen)) == 3
    list(runs[1].events())
    assert runs[0].checkpoint() == runs[1].checkpoint()


def test_a_run_that_has_not_begun_has_nothing_to_evaluate(case: Case) -> None:
    with pytest.raises(RuntimeError, match="before its first event"):
        case.begin(probes.observed_reward()).evaluate(1)
