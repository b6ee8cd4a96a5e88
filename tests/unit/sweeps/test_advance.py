"""What a sweep does next, by its record and its trials alone."""

from typing import Any

import pytest

from core.sweeps.advance import CancelTrial, EndSweep, PruneTrial, StartTrial, advance
from core.sweeps.axes import Values
from core.sweeps.sweep import SeenTrial, SweepStatus
from tests.unit.sweeps.making import spec_of, sweep_of, trial_of


def thousand(values: Values) -> int:
    return 1000


def ended(number: int, value: float = 1.0, **said: Any) -> SeenTrial:
    return SeenTrial(trial_of(number, **{"outcome": "succeeded", "values": (value,), "steps": 1000, **said}))


def test_a_grid_starts_its_combinations_in_order_and_as_many_as_may_run() -> None:
    sweep = sweep_of(parameters={"seed": [1, 2], "algorithm.num_envs": [64, 128]}, budget={"parallel": 3})
    assert advance(sweep, [], thousand) == [
        StartTrial(0, {"seed": 1, "algorithm.num_envs": 64}, 1000),
        StartTrial(1, {"seed": 1, "algorithm.num_envs": 128}, 1000),
        StartTrial(2, {"seed": 2, "algorithm.num_envs": 64}, 1000),
    ]
    running = [SeenTrial(trial_of(0)), SeenTrial(trial_of(1)), ended(2)]
    assert advance(sweep, running, thousand) == [StartTrial(3, {"seed": 2, "algorithm.num_envs": 128}, 1000)]


def test_a_grid_ends_when_every_combination_has_ended_however_it_did() -> None:
    sweep = sweep_of()
    assert advance(sweep, [ended(0), SeenTrial(trial_of(1))], thousand) == []
    [end] = advance(sweep, [ended(0), SeenTrial(trial_of(1, outcome="failed"))], thousand)
    assert end == EndSweep(SweepStatus.SUCCEEDED, "Every combination was tried: 1 succeeded, 1 failed.")


@pytest.mark.parametrize("outcome", ["failed", "cancelled", "refused", "deleted", "pruned"])
def test_a_trial_that_did_not_succeed_counts_and_the_next_one_starts(outcome: str) -> None:
    sweep = sweep_of(method="random", budget={"jobs": 2, "parallel": 1})
    [start] = advance(sweep, [SeenTrial(trial_of(0, outcome=outcome))], thousand)
    assert isinstance(start, StartTrial)
    assert start.number == 1


def test_steps_are_promised_to_trials_before_they_are_taken() -> None:
    # 3,500 steps: three trials of 1,000 fit, a fourth does not while all three may take their steps.
    sweep = sweep_of(method="random", budget={"steps": 3500, "parallel": 10})
    starts = advance(sweep, [], thousand)
    assert [start.number for start in starts if isinstance(start, StartTrial)] == [0, 1, 2]
    # The third was pruned after 400 steps: 1,000 + 1,000 + 400 + 1,000 = 3,400 fit.
    seen = [ended(0), ended(1), SeenTrial(trial_of(2, outcome="pruned", steps=400))]
    assert [start.number for start in advance(sweep, seen, thousand) if isinstance(start, StartTrial)] == [3]
    [end] = advance(sweep, [*seen, ended(3)], thousand)
    assert isinstance(end, EndSweep)
    assert end.message == "Its budget of steps is used: 3 succeeded, 1 pruned."


def test_no_trial_starts_once_the_gpu_hours_are_spent() -> None:
    sweep = sweep_of(method="random", budget={"gpu_hours": 1.0})
    assert (
        advance(
            sweep,
            [SeenTrial(trial_of(0, gpu_hours=0.6)), SeenTrial(trial_of(1, gpu_hours=0.4))],
            thousand,
        )
        == []
    )


def test_a_cancelled_sweep_cancels_what_runs_and_ends_after_it() -> None:
    sweep = sweep_of().next(status=SweepStatus.CANCELLING)
    running = trial_of(1)
    assert advance(sweep, [ended(0), SeenTrial(running)], thousand) == [CancelTrial(running)]
    [end] = advance(sweep, [ended(0), SeenTrial(trial_of(1, outcome="cancelled"))], thousand)
    assert end == EndSweep(SweepStatus.CANCELLED, "It was cancelled: 1 succeeded, 1 cancelled.")


def test_a_pruned_trial_is_cancelled_again_until_its_job_has_ended() -> None:
    sweep = sweep_of(budget={"parallel": 1})
    pruned = trial_of(0, is_pruned=True)
    assert advance(sweep, [SeenTrial(pruned)], thousand) == [CancelTrial(pruned)]


def test_the_worse_half_is_pruned_and_its_place_is_taken() -> None:
    sweep = sweep_of(
        method="random", budget={"jobs": 10, "parallel": 2}, pruning={"kind": "median", "startup_trials": 2}
    )
    curves: list[dict[int, float]] = [{10: 1.0, 20: 4.0}, {10: 3.0, 20: 5.0}]
    others = [SeenTrial(ended(number).trial, curve) for number, curve in enumerate(curves)]
    # At step 10 the median of 1 and 3 is 2.
    bad, good = SeenTrial(trial_of(2), {10: 1.5}), SeenTrial(trial_of(3), {10: 2.5})
    assert advance(sweep, [*others, bad, good], thousand) == [PruneTrial(bad.trial)]
    minimizing = sweep.model_copy(
        update={
            "spec": sweep.spec.model_copy(
                update={
                    "objective": spec_of(
                        objective={"metric": "eval/episode_reward", "direction": "minimize"}
                    ).objective
                }
            )
        }
    )
    assert advance(minimizing, [*others, bad, good], thousand) == [PruneTrial(good.trial)]


def test_the_same_records_give_the_same_decisions() -> None:
    rate, cost = ({"low": 1e-4, "high": 1e-2, "log": True} for _ in range(2))
    parameters = {"algorithm.learning_rate": rate, "algorithm.entropy_cost": cost}
    for method in ("random", "qmc", "tpe", "cma_es", "nsga2"):
        sweep = sweep_of(method=method, parameters=parameters, budget={"jobs": 30, "parallel": 2})
        seen: list[SeenTrial] = []
        for number in range(14):
            first = advance(sweep, seen, thousand)
            assert advance(sweep, seen, thousand) == first
            assert isinstance(first[0], StartTrial)
            values = first[0].parameters
            seen.append(ended(number, float(number), parameters=values))
        drawn = [one.trial.parameters["algorithm.learning_rate"] for one in seen]
        assert len(set(drawn)) == 14
