"""Samplers over our own records."""

import math
import time
from datetime import timedelta
from typing import Any

import pytest

from core.sweeps.results import importance
from core.sweeps.samplers import ask
from core.sweeps.sweep import SeenTrial
from tests.unit.sweeps.making import NOON, spec_of, trial_of

RATE = "algorithm.learning_rate"
PARAMETERS = {
    RATE: {"low": 1e-5, "high": 1e-1, "log": True},
    "algorithm.num_envs": {"low": 64, "high": 250, "step": 64},  # Its last step ends at 192.
    "algorithm.entropy_cost": {"low": 0.0, "high": 0.25, "step": 0.1},
    "algorithm.policy_hidden_layer_sizes": [[32, 32], [64]],
    "algorithm.normalize_observations": [True, False],
    "environment.options.healthy_reward": [1, 1.0, None],
}
OTHERS = {
    "algorithm.num_envs": 192,
    "algorithm.entropy_cost": 0.2,
    "algorithm.policy_hidden_layer_sizes": [64],
    "algorithm.normalize_observations": False,
    "environment.options.healthy_reward": 1.0,
}


def tried(number: int, rate: float, **said: Any) -> SeenTrial:
    """A trial whose value is best at a rate of 1e-3."""
    value = -abs(math.log10(rate) + 3)
    facts = {"parameters": {RATE: rate, **OTHERS}, "values": (value,), "outcome": "succeeded", **said}
    return SeenTrial(trial_of(number, **facts), {100: value})


def test_it_draws_where_values_were_good() -> None:
    spec = spec_of(method="tpe", parameters=PARAMETERS, budget={"jobs": 100})
    seen = [tried(number, 10 ** (-5 + 4 * number / 39)) for number in range(40)]
    drawn = [float(ask(spec, number, seen)[RATE]) for number in range(40, 60)]  # pyright: ignore
    # Of random draws a quarter would lie this near to 1e-3.
    assert sum(abs(math.log10(rate) + 3) < 0.5 for rate in drawn) > 12


@pytest.mark.parametrize("method", ["qmc", "tpe", "cma_es", "nsga2"])
def test_every_outcome_is_understood_and_every_value_is_one_of_the_axis(method: str) -> None:
    taken = {
        name: axis for name, axis in PARAMETERS.items() if method != "cma_es" or not isinstance(axis, list)
    }
    spec = spec_of(method=method, parameters=taken, budget={"jobs": 100})
    seen = [tried(number, 1e-3) for number in range(10)]
    seen += [
        tried(10, 1e-2, outcome=None, values=()),
        tried(11, 1e-2, outcome="failed", values=(None,)),
        tried(12, 1e-2, outcome="refused", values=()),
        tried(13, 1e-2, outcome="pruned"),
        SeenTrial(trial_of(14, parameters={RATE: 1e-2, **OTHERS}, outcome="pruned", values=(None,))),
        tried(15, 1e-2, outcome="succeeded", values=(None,)),
    ]
    for number in range(16, 26):
        values = ask(spec, number, seen)
        assert ask(spec, number, seen) == values
        assert values["algorithm.num_envs"] in (64, 128, 192)
        assert values["algorithm.entropy_cost"] in (0.0, 0.1, 0.2)
        assert 1e-5 <= values[RATE] <= 1e-1  # pyright: ignore
        assert set(values) == set(taken)
        if method != "cma_es":
            assert values["algorithm.policy_hidden_layer_sizes"] in ([32, 32], [64])
            assert type(values["algorithm.normalize_observations"]) is bool


def swept(method: str, num_trials: int, objective: Any) -> list[tuple[float, ...]]:
    """The last 20 trials' values, by the distances from 1 and from 0 on each axis; four run at a time."""
    axes = {name: {"low": -2.0, "high": 2.0} for name in "wxyz"}
    spec = spec_of(method=method, parameters=axes, budget={"jobs": num_trials}, objective=objective)
    seen = list[SeenTrial]()
    for first in range(0, num_trials, 4):
        begun = list[SeenTrial]()
        for number in range(first, first + 4):
            begun.append(SeenTrial(trial_of(number, parameters=ask(spec, number, [*seen, *begun]))))
        for one in begun:
            at = [float(value) for value in one.trial.parameters.values()]  # pyright: ignore
            values = (-sum((x - 1) ** 2 for x in at), -sum(x**2 for x in at))[: len(spec.objectives)]
            ended_at = NOON + timedelta(
                minutes=first, seconds=-one.trial.number
            )  # The last of four ends first.
            ended = {"outcome": "succeeded", "values": values, "finished_at": ended_at}
            seen.append(SeenTrial(one.trial.model_copy(update=ended)))
    return [tuple(value or 0.0 for value in one.trial.values) for one in seen[-20:]]


@pytest.mark.parametrize(
    ("method", "num_trials", "objective"),
    [("cma_es", 60, [{"metric": "a"}]), ("nsga2", 100, [{"metric": "a"}, {"metric": "b"}])],
)
def test_generations_that_are_made_again_from_the_records_come_nearer(
    method: str, num_trials: int, objective: Any
) -> None:
    last = swept(method, num_trials, objective)
    # Random draws have means of -28/3 and -16/3: E[(x - 1)²] = 7/3 and E[x²] = 4/3 on each of four axes.
    # Draws around the middle, with which CMA-ES begins, have -4 - 4 (4/6)² = -5.8.
    for column, random_mean in zip(zip(*last, strict=True), (-28 / 3, -16 / 3), strict=False):
        assert sum(column) / 20 > random_mean / 2


def test_sobol_points_fill_every_part_of_every_axis() -> None:
    axes = {"x": {"low": 0.0, "high": 1.0}, "y": {"low": 1, "high": 8}, "z": ["a", "b"]}
    drawn = [ask(spec_of(method="qmc", parameters=axes, budget={"jobs": 16}), n, ()) for n in range(16)]
    # Each sixteenth of an axis has one of the first 16 points: each number comes twice, a letter 8 times.
    assert sorted(int(16 * float(one["x"])) for one in drawn) == list(range(16))  # pyright: ignore
    assert sorted(one["y"] for one in drawn) == sorted(2 * list(range(1, 9)))  # pyright: ignore
    assert [one["z"] for one in drawn].count("a") == 8
    other = spec_of(method="qmc", parameters=axes, budget={"jobs": 16}, seed=1)
    assert ask(other, 0, ()) != drawn[0]


def test_several_objectives_are_drawn_for_and_weighed_one_by_one() -> None:
    objectives = [
        {"metric": "eval/episode_reward"},
        {"metric": "eval/avg_episode_length", "direction": "minimize"},
    ]
    spec = spec_of(method="tpe", parameters=PARAMETERS, budget={"jobs": 100}, objective=objectives)
    seen = [tried(n, 10 ** (-5 + n / 5), values=(float(n), float(n % 3))) for n in range(15)]
    assert set(ask(spec, 15, seen)) == set(PARAMETERS)
    shares, note = importance(spec, seen)
    assert note is None
    assert shares is not None
    assert set(shares) == {"eval/episode_reward", "eval/avg_episode_length"}
    # Nothing else varied. What PED-ANOVA smooths over 15 trials leaves the others a little.
    assert max(shares["eval/episode_reward"].items(), key=lambda pair: pair[1])[0] == RATE
    assert sum(shares["eval/episode_reward"].values()) == pytest.approx(1)


def test_without_a_difference_there_is_no_importance() -> None:
    spec = spec_of(method="tpe", parameters=PARAMETERS, budget={"jobs": 100})
    seen = [tried(number, 1e-3) for number in range(5)]
    assert importance(spec, seen) == (None, "All trials have the same eval/episode_reward.")
    assert importance(spec, seen[:3]) == (None, "It needs 4 trials that succeeded, and has 3.")


def test_long_lists_cost_no_more_than_a_short_one() -> None:
    """Eight lists of 1,000 values took a minute, in which the reconciler saw no lease run out."""
    numbers = [round(n / 1000, 3) for n in range(1000)]
    lists = {f"environment.options.x{n}": numbers for n in range(8)}
    spec = spec_of(method="random", parameters=lists, budget={"jobs": 1000})
    seen = [
        SeenTrial(
            trial_of(n, parameters=dict.fromkeys(lists, numbers[n]), outcome="succeeded", values=(n % 17,))
        )
        for n in range(1000)
    ]
    importance(spec, seen[:10])  # Loads Optuna.
    before = time.process_time()
    shares, _ = importance(spec, seen)
    assert shares is not None
    assert time.process_time() - before < 10
