"""What a run tells while it goes on, and how it ends when values are not finite."""

import jax
import pytest

from core.algorithms.events import CheckpointReady, Evaluated, Event, Phase, Progress
from core.algorithms.ppo.checkpoint import FORMAT
from core.errors import JobFailed
from tests import probes
from tests.learning.runs import STEPS_PER_UPDATE, small_run


def names(events: list[Event]) -> list[str]:
    """Events as words, in their order."""
    return [
        f"phase {event.name}" if isinstance(event, Phase) else f"{type(event).__name__} {event.step}"
        for event in events
    ]


def test_events_come_in_their_order_and_nothing_compiles_after_the_start() -> None:
    compilations = list[str]()

    def note(event: str, duration: float, **_: object) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            compilations.append(event)

    jax.monitoring.register_event_duration_secs_listener(note)
    # Six updates: evaluations after 3 and 6, checkpoints at 1000 steps (update 2), 2000 (4), 3000 (6).
    run = small_run(
        probes.endless(),
        num_timesteps=6 * STEPS_PER_UPDATE,
        num_evals=2,
        checkpoint_every_steps=1000,
        epoch_s=1000.0,
    )
    events = list[Event]()
    compiled_at_start = 0
    for event in run.events():
        if isinstance(event, Phase) and event.name == "compile":
            compiled_at_start = len(compilations)
        if isinstance(event, CheckpointReady):
            assert FORMAT.read(run.checkpoint())[0]["progress"]["step"] == event.step
        events.append(event)
    assert names(events) == [
        "phase trace",
        "phase compile",
        "phase first_update",
        "Progress 512",
        "Progress 1024",
        "CheckpointReady 1024",
        "Progress 1536",
        "Evaluated 1536",
        "Progress 2048",
        "CheckpointReady 2048",
        "Progress 3072",
        "Evaluated 3072",
        "CheckpointReady 3072",
    ]
    assert compiled_at_start > 0
    assert len(compilations) == compiled_at_start

    progress = [event for event in events if isinstance(event, Progress)][-1]
    assert progress.total == 3072
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


def test_a_run_that_diverges_names_step_and_quantity_and_keeps_the_last_good_state() -> None:
    # The reward breaks with an episode's 41st step. An update has 16 steps of 32 environments, so this is
    # time step 8 of the third update: environment step 2 · 512 + 8 · 32 = 1280.
    run = small_run(probes.exploding(after=40), episode_length=1000, epoch_s=1000.0)
    with pytest.raises(JobFailed, match="reward became non-finite at environment step 1280") as failure:
        list(run.events())
    assert failure.value.reason == "diverged"
    assert failure.value.facts == {"step": 1280, "quantity": "reward"}
    assert run.step == 2 * STEPS_PER_UPDATE
    header, state = FORMAT.read(run.checkpoint())
    assert header["progress"]["step"] == 2 * STEPS_PER_UPDATE
    assert all(jax.numpy.isfinite(leaf).all() for leaf in jax.tree.leaves(state["params"]))


def test_a_loss_that_overflows_is_told_from_a_reward_that_does() -> None:
    # 1e38 is a float32, and 1e6 times it is none: the rewards are finite and the loss is not.
    run = small_run(probes.unending_reward(1e38), reward_scaling=1e6)
    with pytest.raises(JobFailed, match="policy loss became non-finite at environment step 512") as failure:
        list(run.events())
    assert failure.value.facts == {"step": STEPS_PER_UPDATE, "quantity": "policy loss"}
    assert run.step == 0


def test_a_second_evaluation_has_other_starts_and_changes_nothing() -> None:
    """The probe's reward is what an episode's start drew."""
    runs = [
        small_run(probes.observed_reward(), num_timesteps=2 * STEPS_PER_UPDATE, num_evals=1) for _ in range(2)
    ]
    seen = list[float]()
    for event in runs[0].events():
        if isinstance(event, Evaluated):
            values = [runs[0].evaluate(seed)["eval/episode_reward"] for seed in (1, 1, 2)]
            seen = [event.metrics["eval/episode_reward"], *values]
    assert seen[1] == seen[2]
    assert len(set(seen)) == 3
    list(runs[1].events())
    assert runs[0].checkpoint() == runs[1].checkpoint()


def test_a_run_that_has_not_begun_has_nothing_to_evaluate() -> None:
    with pytest.raises(RuntimeError, match="before its first event"):
        small_run(probes.observed_reward()).evaluate(1)
