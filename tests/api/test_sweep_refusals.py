"""Sweeps that cannot work, each refused with its place and a sentence."""

import time
from typing import Any

import pytest

from core.sweeps.checks import _repeated  # pyright: ignore[reportPrivateUsage]
from tests.api.conftest import Stack
from tests.api.problems import pointers, problem
from tests.api.test_sweeps import JOB, METRIC, post

RATE = "algorithm.learning_rate"
RANGE = {"low": 1e-4, "high": 1e-2}
MASS = {"field": "body_mass", "range": [0.9, 1.1]}


@pytest.mark.parametrize(
    ("changes", "pointer", "sentence"),
    [
        ({"parameters": {}}, "/parameters", 'A sweep needs an axis, for example `"seed": [1, 2, 3]`.'),
        (
            {"parameters": {"algorithm.learning_rat": [1e-3]}},
            "/parameters/algorithm.learning_rat",
            "`algorithm.learning_rat` is not a field of this job; did you mean `algorithm.learning_rate`?",
        ),
        (
            {"parameters": {"learning_rate": [1e-3]}},
            "/parameters/learning_rate",
            "`learning_rate` is not a field of this job; did you mean `algorithm.learning_rate`?",
        ),
        (
            {"parameters": {"environment": ["ant", "hopper"], "environment.options.healthy_reward": [0.5]}},
            "/parameters/environment.options.healthy_reward",
            "`environment.options.healthy_reward` is a part of the axis `environment`; leave one out.",
        ),
        (
            {"parameters": {"algorithm.learning_rate": [1e-3, 3]}},
            "/parameters/algorithm.learning_rate",
            "`algorithm.learning_rate` = 3: must be less than or equal to 1.",
        ),
        (
            {"parameters": {"algorithm.num_envs": {"low": 64, "high": 128.5, "step": 64}}},
            "/parameters/algorithm.num_envs",
            "`algorithm.num_envs` = 64.0: must be a valid integer.",
        ),
        (
            {"parameters": {"environment.options.healthy_reward": ["much"]}},
            "/parameters/environment.options.healthy_reward",
            None,
        ),
        ({"parameters": {"seed": [1, 2, 1]}}, "/parameters/seed", "`seed` has the value 1 twice."),
        (  # L3: it was an overflow.
            {"parameters": {RATE: {"low": 0, "high": 1e300, "step": 1e-300}}},
            f"/parameters/{RATE}",
            f"`{RATE}`: `step` = 1e-300 is so small that the range has more than 1,000,000,000,000 values.",
        ),
        (
            {
                "parameters": {
                    "seed": {"low": 1, "high": 1000, "step": 1},
                    "algorithm.num_envs": {"low": 1, "high": 1000, "step": 1},
                }
            },
            "/parameters",
            "The grid has 1,000,000 combinations, but a sweep has 1,000 trials at most: take fewer values, "
            "or the method `random` or `tpe` with a budget.",
        ),
        (
            {"parameters": {"algorithm.learning_rate": {"low": 1e-3, "high": 1e-4, "points": 3}}},
            "/parameters/algorithm.learning_rate",
            "`algorithm.learning_rate`: `low` must be below `high`; for a single value, set it in `job`.",
        ),
        (  # Each look at the sweep read 12 MB.
            {
                "parameters": {"randomization": [[{**MASS, "draw": "d" * 200, "axis": None}] * 20]},
                "method": "random",
                "budget": {"jobs": 900},
            },
            "/parameters",
            "A trial's settings have up to 5,259 bytes as JSON. With 900 trials at most 2,330 are allowed: "
            "vary shorter values, or set fewer trials as `jobs` in the budget.",
        ),
        ({"parameters": {"seed": []}}, "/parameters/seed", "`seed` needs at least 1 item, and has none."),
        ({"parameters": {"seed": {"low": 1}}}, "/parameters/seed/high", "`high` is missing."),
        (
            {"parameters": {"seed": "1, 2"}},
            "/parameters/seed",
            "`seed`: must be an object, not '1, 2'.",
        ),
        (
            {"objective": {"metric": ""}},
            "/objective/metric",
            "`metric`: string should have at least 1 character.",
        ),
        (
            {"objective": {"metric": "eval/episode_rewrd"}},
            "/objective/metric",
            "A job of this kind on ant reports no metric 'eval/episode_rewrd'; did you mean "
            "`eval/episode_reward`?",
        ),
        (
            {"objective": [{"metric": METRIC}, {"metric": "eval/episode_reward_dist"}]},
            "/objective/1/metric",
            None,
        ),
        ({"budget": {"jobs": 0}}, "/budget/jobs", None),
        (
            {"budget": {"steps": 999}},
            "/budget/steps",
            "The budget of 999 steps allows no trial: one takes 1,000 steps.",
        ),
        (
            {"method": "random"},
            "/budget",
            "The method `random` has no end of its own: give `jobs`, `steps` or `gpu_hours`.",
        ),
        ({"method": "bayes"}, "/method", None),
        (
            {"method": "cma_es", "parameters": {"seed": [1, 2], RATE: RANGE}, "budget": {"jobs": 9}},
            "/parameters/seed",
            "`cma_es` takes ranges alone, and `seed` is a list; give a range, or take `tpe`.",
        ),
        (
            {
                "method": "cma_es",
                "parameters": {RATE: RANGE, "algorithm.num_envs": {"low": 64, "high": 100, "step": 64}},
                "budget": {"jobs": 9},
            },
            "/parameters",
            "`cma_es` learns how axes depend on each other; give two ranges, or take `tpe`.",
        ),
        (
            {
                "method": "cma_es",
                "parameters": {RATE: RANGE, "algorithm.entropy_cost": RANGE},
                "objective": [{"metric": METRIC}, {"metric": "eval/forward_speed"}],
                "budget": {"jobs": 9},
            },
            "/objective",
            "`cma_es` follows one objective; give one, or take `tpe` or `nsga2`.",
        ),
        ({"job": {**JOB, "environment": "aunt"}}, "/job/environment", None),
        ({"job": {**JOB, "seeed": 1}}, "/job/seeed", "`seeed` is not a field here; did you mean `seed`?"),
        ({"paramters": {}}, "/paramters", "`paramters` is not a field here; did you mean `parameters`?"),
        (
            {
                "job": {"kind": "rollout", "environment": "ant", "policy": {"kind": "random"}},
                "pruning": {"kind": "median"},
                "parameters": {"seed": [1, 2]},
            },
            "/pruning",
            "A rollout reports its metrics once, at its end, so nothing can be pruned.",
        ),
        (
            {
                "objective": [{"metric": METRIC}, {"metric": "eval/forward_speed"}],
                "pruning": {"kind": "median"},
            },
            "/pruning",
            "Pruning compares trials by one objective, and this sweep has several.",
        ),
    ],
)
def test_a_sweep_that_cannot_work_is_refused_in_a_sentence(
    stack: Stack, changes: dict[str, Any], pointer: str, sentence: str | None
) -> None:
    refused = problem(post(stack, **changes), 422, "invalid-request")
    assert pointers(refused) == [pointer]
    if sentence is not None:
        assert refused["errors"][0]["detail"] == sentence
    assert stack.http.get("/sweeps").json()["items"] == []


def test_64_axes_of_a_thousand_values_take_a_moment() -> None:
    """L3: each value was compared with all before it."""
    parameters = {f"environment.options.a{axis}": list(range(1000)) for axis in range(64)}
    before = time.thread_time()
    assert all(_repeated(values) is None for values in parameters.values())
    assert time.thread_time() - before < 0.5
    assert _repeated([1, True, 1.0, "1", [1], None]) is None
    assert _repeated([{"a": 1, "b": 2}, {"b": 2, "a": 1}]) == '{"a": 1, "b": 2}'
