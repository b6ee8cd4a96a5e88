"""Population-based training: who continues, who resumes from whom, and with which settings."""

import random
from typing import Any

import pytest
from pydantic import ValidationError

from core.sweeps.advance import EndSweep, StartTrial, advance, why_no_more
from core.sweeps.axes import Values, neighbours, scaled
from core.sweeps.pbt import generations
from core.sweeps.spec import Population, Range
from core.sweeps.sweep import SeenTrial, Sweep, SweepStatus, Trial
from tests.unit.sweeps.making import sweep_of, trial_of

RATE = "algorithm.learning_rate"
JOB = {"kind": "train", "environment": "ant", "algorithm": {"num_timesteps": 1000}, "seed": 7}


def pbt_sweep(**said: Any) -> Sweep:
    """Four members in three generations: 333, 667 and 1,000 steps; the worst one is replaced."""
    facts = {
        "job": JOB,
        "method": "pbt",
        "parameters": {RATE: {"low": 1e-4, "high": 1e-2, "log": True}},
        "population": {"size": 4, "generations": 3, "resample_probability": 0.0},
        "budget": {"parallel": 4},
    }
    return sweep_of(**{**facts, **said})


def steps_of(settings: Values) -> int:
    steps = settings["algorithm.num_timesteps"]
    assert isinstance(steps, int)
    return steps


def ended(number: int, value: float | None, **said: Any) -> SeenTrial:
    facts = {"outcome": "succeeded", "values": (value,), "steps": 333, "parameters": {RATE: 1e-3}}
    return SeenTrial(trial_of(number, **{**facts, **said}))


def starts(sweep: Sweep, seen: list[SeenTrial]) -> list[StartTrial]:
    found = advance(sweep, seen, steps_of)
    assert all(isinstance(one, StartTrial) for one in found)
    return [one for one in found if isinstance(one, StartTrial)]


def test_the_first_generation_is_drawn_at_random_and_trains_the_first_part() -> None:
    first = starts(pbt_sweep(), [])
    assert [start.number for start in first] == [0, 1, 2, 3]
    assert len({start.parameters[RATE] for start in first}) == 4
    assert [start.settings for start in first] == [
        {"algorithm.num_timesteps": 333, "seed": 7 + member} for member in range(4)
    ]
    assert [(start.planned_steps, start.parent, start.inherited_steps) for start in first] == 4 * [
        (333, None, 0)
    ]


def test_a_generation_waits_for_all_of_the_one_before() -> None:
    seen = [ended(0, 1.0), ended(1, 2.0), ended(2, 3.0)]
    assert advance(pbt_sweep(), [*seen, SeenTrial(trial_of(3))], steps_of) == []
    # Two run at the same time: the generation that began is completed first.
    assert [one.number for one in starts(pbt_sweep(budget={"parallel": 2}), seen[:2])] == [2, 3]


def test_the_worst_resumes_from_the_best_with_other_settings_and_the_others_continue() -> None:
    seen = [ended(0, 5.0), ended(1, 9.0), ended(2, 1.0), ended(3, 7.0)]
    second = starts(pbt_sweep(), seen)
    # A quarter of four members is one: trial 2 is the worst, trial 1 the best.
    assert [(start.number, start.parent) for start in second] == [(4, 0), (5, 1), (6, 1), (7, 3)]
    for start, member in zip(second, range(4), strict=True):
        assert start.settings == {
            "algorithm.num_timesteps": 667,
            "seed": 7 + member,
            "resume_from": {"job": f"job {start.parent}"},
        }
        # The parent's run stands at step 333, and this one goes to 667.
        assert (start.inherited_steps, start.planned_steps) == (333, 334)
    assert [start.parameters[RATE] for start in second if start.number != 6] == 3 * [1e-3]
    assert second[2].parameters[RATE] in (pytest.approx(0.8e-3), pytest.approx(1.2e-3))


def test_less_is_better_where_the_objective_says_so() -> None:
    sweep = pbt_sweep(objective={"metric": "eval/episode_reward", "direction": "minimize"})
    seen = [ended(0, 5.0), ended(1, 9.0), ended(2, 1.0), ended(3, 7.0)]
    assert [start.parent for start in starts(sweep, seen)] == [0, 2, 2, 3]


@pytest.mark.parametrize(
    "lost",
    [
        {"outcome": "failed"},
        {"outcome": "cancelled"},
        {"outcome": "refused", "job": None, "values": ()},
        {"outcome": "deleted", "job": None, "values": ()},
        {"values": (None,)},
        {"job": None},
    ],
)
def test_a_member_that_cannot_be_resumed_is_replaced_first(lost: dict[str, Any]) -> None:
    """However good it was. The one that was worst with a value is then not among the worst quarter."""
    seen = [ended(0, 5.0), ended(1, 99.0, **lost), ended(2, 1.0), ended(3, 7.0)]
    assert [start.parent for start in starts(pbt_sweep(), seen)] == [0, 3, 2, 3]


def test_more_lost_members_than_the_worst_share_are_all_replaced() -> None:
    seen = [ended(0, 5.0), *(ended(number, None, outcome="failed") for number in (1, 2, 3))]
    assert [start.parent for start in starts(pbt_sweep(), seen)] == [0, 0, 0, 0]


def test_parents_are_drawn_among_the_best_share() -> None:
    population = {"size": 8, "generations": 2, "truncation": 0.5}
    seen = [ended(number, float(number)) for number in range(8)]
    parents = set[int | None]()
    for seed in range(20):
        sweep = pbt_sweep(population=population, budget={"parallel": 8}, seed=seed)
        second = starts(sweep, seen)
        assert [start.parent for start in second[4:]] == [4, 5, 6, 7]
        parents |= {start.parent for start in second[:4]}
    assert parents == {4, 5, 6, 7}


def test_of_equal_members_the_first_are_the_best() -> None:
    assert [start.parent for start in starts(pbt_sweep(), [ended(n, 1.0) for n in range(4)])] == [0, 1, 2, 0]


def test_a_lineage_adds_its_steps_up_to_the_whole_budget() -> None:
    seen = [ended(n, float(n)) for n in range(4)]
    seen += [ended(n, float(n), parent=n - 4, inherited_steps=333, steps=340) for n in range(4, 8)]
    last = starts(pbt_sweep(), seen)
    # Trial 5 ended at 333 + 340 = 673, as a last update may pass the budget; 327 are left of 1,000.
    assert [(one.number, one.parent, one.inherited_steps, one.planned_steps) for one in last] == [
        (8, 7, 673, 327),
        (9, 5, 673, 327),
        (10, 6, 673, 327),
        (11, 7, 673, 327),
    ]
    assert last[0].settings["algorithm.num_timesteps"] == 1000
    seen += [ended(n, float(n)) for n in range(8, 12)]
    [end] = advance(pbt_sweep(), seen, steps_of)
    assert end == EndSweep(SweepStatus.SUCCEEDED, "Every generation was trained: 12 succeeded.")


def test_budgets_hold_within_a_generation() -> None:
    seen = [ended(number, 1.0) for number in range(4)]
    of_jobs = pbt_sweep(budget={"jobs": 6})
    assert [start.number for start in starts(of_jobs, seen)] == [4, 5]
    # 4 × 333 are used, and each of the next takes 334: 2,000 are reached by the second.
    of_steps = pbt_sweep(budget={"steps": 2000})
    assert [start.number for start in starts(of_steps, seen)] == [4, 5]


def test_a_population_of_which_none_is_left_fails_in_a_sentence() -> None:
    seen = [ended(0, None, outcome="failed"), *(ended(number, None) for number in (1, 2, 3))]
    [end] = advance(pbt_sweep(), seen, steps_of)
    sentence = "No trial of generation 0 has a value and a job to resume from: 1 failed, 3 succeeded."
    assert end == EndSweep(SweepStatus.FAILED, sentence)
    # Jobs may be deleted while a generation begins: what runs is waited for.
    assert advance(pbt_sweep(), [*seen, SeenTrial(trial_of(4))], steps_of) == []


def cancelled(number: int) -> SeenTrial:
    return ended(number, None, outcome="cancelled", steps=100)


def test_a_generation_of_which_a_cancel_left_nothing_begins_again() -> None:
    seen = [ended(0, 5.0), ended(1, 9.0), ended(2, 1.0), ended(3, 7.0)]
    again = starts(pbt_sweep(), [*seen, *map(cancelled, range(4, 8))])
    assert [(start.number, start.parent, start.inherited_steps, start.planned_steps) for start in again] == [
        (8, 0, 333, 334),
        (9, 1, 333, 334),
        (10, 1, 333, 334),
        (11, 3, 333, 334),
    ]
    assert [start.settings["seed"] for start in again] == [7, 8, 9, 10]


def test_a_first_generation_that_was_cancelled_begins_again_with_other_settings() -> None:
    first = starts(pbt_sweep(), [])
    again = starts(pbt_sweep(), [cancelled(number) for number in range(4)])
    assert [(start.number, start.parent, start.settings) for start in again] == [
        (4 + number, None, start.settings) for number, start in enumerate(first)
    ]
    assert {start.parameters[RATE] for start in again}.isdisjoint(start.parameters[RATE] for start in first)


def test_a_last_generation_that_was_cancelled_begins_again() -> None:
    seen = [ended(number, float(number)) for number in range(8)]
    seen += [cancelled(8), cancelled(9), ended(10, None, outcome="failed"), cancelled(11)]
    assert why_no_more(pbt_sweep().spec, [one.trial for one in seen]) is None
    assert [start.number for start in starts(pbt_sweep(), seen)] == [12, 13, 14, 15]
    seen += [ended(number, float(number)) for number in range(12, 16)]
    population = pbt_sweep().spec.population
    assert population is not None
    assert generations(population, [one.trial for one in seen]) == [0] * 4 + [1] * 4 + [2] * 8
    [end] = advance(pbt_sweep(), seen, steps_of)
    assert end == EndSweep(
        SweepStatus.SUCCEEDED, "Every generation was trained: 12 succeeded, 3 cancelled, 1 failed."
    )


def test_a_generation_that_a_cancel_interrupted_is_completed_first() -> None:
    seen = [cancelled(0), cancelled(1)]
    assert [start.number for start in starts(pbt_sweep(budget={"parallel": 2}), seen)] == [2, 3]


def test_the_same_records_give_the_same_decisions_whatever_was_begun_already() -> None:
    """A process that died between two starts, or another one beside it, changes nothing."""
    sweep = pbt_sweep(
        parameters={
            RATE: {"low": 1e-4, "high": 1e-2, "log": True},
            "algorithm.num_updates_per_batch": [2, 4, 8],
        },
        population={"size": 6, "generations": 2, "truncation": 0.5, "resample_probability": 0.5},
        budget={"parallel": 6},
    )
    generator = random.Random(1)
    seen = [
        ended(start.number, generator.random(), parameters=start.parameters) for start in starts(sweep, [])
    ]
    whole = starts(sweep, seen)
    assert starts(sweep, seen) == whole
    for begun in range(1, 6):
        running = [
            SeenTrial(Trial.model_validate({**vars(trial_of(one.number)), "parameters": one.parameters}))
            for one in whole[:begun]
        ]
        assert starts(sweep, [*seen, *running]) == whole[begun:]


class TestSettings:
    """The next value of one setting of a member that is replaced."""

    @pytest.mark.parametrize(
        ("axis", "value", "factor", "wanted"),
        [
            ({"low": 0.0, "high": 1.0}, 0.5, 1.2, 0.6),
            ({"low": 0.0, "high": 1.0}, 0.9, 1.2, 1.0),  # 1.08 is beyond the end
            ({"low": 0.5, "high": 1.0}, 0.6, 0.8, 0.5),  # 0.48 is
            ({"low": -1.0, "high": 1.0}, -0.5, 1.2, -0.6),
            ({"low": 0.0, "high": 1.0}, 0.0, 1.2, 0.0),
            ({"low": 1, "high": 100}, 10, 1.2, 12),
            ({"low": 1, "high": 100}, 7, 0.8, 6),  # 5.6
            ({"low": 1, "high": 100}, 2, 1.2, 3),  # 2.4 would be 2 again
            ({"low": 1, "high": 100}, 2, 0.8, 1),  # so would 1.6
            ({"low": 1, "high": 100}, 1, 0.8, 1),  # the end
            ({"low": 1, "high": 100, "log": True}, 90, 1.2, 100),
            ({"low": 5, "high": 20, "step": 5}, 10, 1.2, 15),  # 12 is nearest to 10 again
            ({"low": 5, "high": 22, "step": 5}, 20, 1.2, 20),  # the last step, and not the bound
            ({"low": 0.1, "high": 0.5, "step": 0.1}, 0.3, 0.8, 0.2),
            ({"low": 1, "high": 100}, 10, 1.0, 10),
        ],
    )
    def test_a_number_is_multiplied_and_stays_on_its_axis(
        self, axis: dict[str, Any], value: float, factor: float, wanted: float
    ) -> None:
        found = scaled(Range.model_validate(axis), value, factor)
        assert found == pytest.approx(wanted, abs=1e-12)
        assert type(found) is type(wanted)

    def test_a_choice_gives_way_to_one_beside_it(self) -> None:
        assert neighbours(["a", "b", "c"], "a") == ["b"]
        assert neighbours(["a", "b", "c"], "b") == ["a", "c"]
        assert neighbours([1, True, 0], True) == [1, 0]
        assert neighbours(["a"], "a") == ["a"]

    def test_some_are_drawn_again(self) -> None:
        def changed(probability: float) -> list[float]:
            found = list[float]()
            for seed in range(200):
                population = {"size": 2, "generations": 2, "resample_probability": probability}
                sweep = pbt_sweep(population=population, seed=seed)
                value = starts(sweep, [ended(0, 1.0), ended(1, 2.0)])[0].parameters[RATE]
                assert isinstance(value, float)
                found.append(value)
            return found

        factors = (pytest.approx(0.8e-3), pytest.approx(1.2e-3))
        assert all(one in factors for one in changed(0.0))
        assert not any(one in factors for one in changed(1.0))
        # Of 200 with probability a quarter: 50, with a standard deviation of √(200 × 3/16) = 6.
        assert 30 < sum(one not in factors for one in changed(0.25)) < 70


def test_a_population_is_no_larger_than_a_sweep() -> None:
    with pytest.raises(
        ValidationError, match="100 members in 11 generations are 1,100 trials, but a sweep has"
    ):
        Population(size=100, generations=11)
    assert [Population(size=size, generations=2).num_replaced for size in (2, 4, 8, 9, 100)] == [
        1,
        1,
        2,
        2,
        25,
    ]
    # 0.29 × 100 is a little below 29 in floating point.
    assert Population(size=100, generations=2, truncation=0.29).num_replaced == 29
