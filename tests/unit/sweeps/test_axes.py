"""Values along the axes of a sweep."""

import pytest
from pydantic import ValidationError

from core.sweeps.axes import combinations, grid_values, num_combinations, random_values
from core.sweeps.spec import Range
from tests.unit.sweeps.making import spec_of


@pytest.mark.parametrize(
    ("axis", "expected"),
    [
        (Range(low=0, high=10, step=5), [0, 5, 10]),
        (Range(low=0, high=9, step=5), [0, 5]),
        (Range(low=0.1, high=0.3, step=0.1), [0.1, 0.2, 0.3]),
        (Range(low=0.0, high=1.0, points=3), [0.0, 0.5, 1.0]),
        (Range(low=1e-4, high=1e-2, log=True, points=3), [1e-4, pytest.approx(1e-3), 1e-2]),
        (Range(low=1, high=3, points=9), [1, 2, 3]),
        # Without `points` and `step`: five, or every whole number where they are fewer.
        (Range(low=0.0, high=1.0), [0.0, 0.25, 0.5, 0.75, 1.0]),
        (Range(low=1e-4, high=1.0, log=True), pytest.approx([1e-4, 1e-3, 1e-2, 1e-1, 1.0])),
        (Range(low=0, high=100), [0, 25, 50, 75, 100]),
        (Range(low=7, high=8), [7, 8]),
        (Range(low=2, high=5), [2, 3, 4, 5]),
        (Range(low=1, high=4, log=True), [1, 2, 3, 4]),
    ],
)
def test_a_grid_has_both_ends_and_even_steps(axis: Range, expected: list[float]) -> None:
    assert grid_values(axis) == expected


def test_combinations_are_counted_without_making_them() -> None:
    many = {str(number): Range(low=0, high=9_999_999, step=1) for number in range(2)}
    assert num_combinations(many) == 10**14
    few = spec_of(parameters={"seed": [1, 2], "algorithm.num_envs": [64, 128, 256]}).parameters
    assert num_combinations(few) == len(list(combinations(few))) == 6


def test_draws_stay_in_their_range_and_depend_on_the_seed_and_the_number_alone() -> None:
    parameters = {
        "algorithm.learning_rate": {"low": 1e-5, "high": 1e-3, "log": True},
        "algorithm.num_envs": {"low": 64, "high": 256, "step": 64},
        "algorithm.unroll_length": {"low": 1, "high": 3},
        "seed": [7, 9],
    }
    spec = spec_of(method="random", parameters=parameters)
    drawn = [random_values(spec, number) for number in range(400)]
    assert drawn == [random_values(spec, number) for number in range(400)]
    assert drawn != [random_values(spec.model_copy(update={"seed": 1}), number) for number in range(400)]
    rates = [float(values["algorithm.learning_rate"]) for values in drawn]  # pyright: ignore
    assert min(rates) >= 1e-5
    assert max(rates) <= 1e-3
    # Half of the logarithmic range lies below 1e-4: 200 expected, with a standard deviation of 10.
    assert 160 < sum(rate < 1e-4 for rate in rates) < 240
    assert {values["algorithm.num_envs"] for values in drawn} == {64, 128, 192, 256}
    assert {values["algorithm.unroll_length"] for values in drawn} == {1, 2, 3}
    assert {values["seed"] for values in drawn} == {7, 9}


@pytest.mark.parametrize(
    "wrong",
    [
        {"low": 2, "high": 2},
        {"low": 0, "high": 1, "log": True},
        {"low": 1, "high": 9, "log": True, "step": 2},
        {"low": 1, "high": 9, "points": 3, "step": 2},
        {"low": 1, "high": 9, "step": 0},
        {"low": 1},
        {"low": 1, "high": float("inf")},
    ],
)
def test_what_is_no_range_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValidationError):
        Range.model_validate(wrong)
