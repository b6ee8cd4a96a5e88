"""What is said of several rounds."""

from collections.abc import Callable

import pytest

from bench.measure.statistics import (
    Estimate,
    Spread,
    alternate,
    difference_in_errors,
    estimate,
    percentile,
    ratios,
    spread,
)


def test_a_spread_is_the_median_between_the_extremes() -> None:
    assert spread([3.0, 1.0, 10.0]) == Spread(median=3.0, low=1.0, high=10.0)


def test_a_ratio_is_taken_round_by_round() -> None:
    # The machine was half as fast in the second round: 4/2 = 2/1 = 2. Medians alone would say 3/1.5 too,
    # but their extremes would be 4/1 and 2/2.
    assert ratios([4.0, 2.0], [2.0, 1.0]) == Spread(median=2.0, low=2.0, high=2.0)


def test_ratios_of_unequal_rounds_are_refused() -> None:
    with pytest.raises(ValueError, match="shorter"):
        ratios([1.0, 2.0], [1.0])


@pytest.mark.parametrize(("percent", "expected"), [(50, 50), (99, 99), (99.5, 100), (100, 100), (0, 1)])
def test_a_percentile_is_one_of_the_values(percent: float, expected: float) -> None:
    # Of 1..100 the nearest rank of p % is the ceil(p)th value, and at least the first.
    assert percentile([float(n) for n in range(100, 0, -1)], percent) == expected


def test_nothing_has_no_median_and_no_percentile() -> None:
    with pytest.raises(ValueError, match="median"):
        spread([])
    with pytest.raises(ValueError, match="mean"):
        estimate([])
    with pytest.raises(ValueError, match="percentile"):
        percentile([], 99)


def test_measurements_alternate_and_turn_round() -> None:
    order: list[str] = []

    def measured(name: str) -> Callable[[], int]:
        return lambda: order.append(name) or len(order)

    results = alternate(3, a=measured("a"), b=measured("b"))

    assert order == ["a", "b", "b", "a", "a", "b"]
    assert results == {"a": [1, 4, 5], "b": [2, 3, 6]}


def test_a_standard_error_is_the_deviation_over_the_root_of_the_seeds() -> None:
    # 1, 2, 3: deviation √((1 + 0 + 1) / 2) = 1, error 1 / √3.
    assert estimate([1.0, 2.0, 3.0]) == Estimate(mean=2.0, error=pytest.approx(0.57735, abs=1e-5))


def test_one_seed_has_no_standard_error() -> None:
    assert estimate([5.0]) == Estimate(5.0, None)
    assert difference_in_errors(Estimate(5.0, None), Estimate(4.0, 1.0)) is None
    assert difference_in_errors(Estimate(5.0, 0.0), Estimate(4.0, 0.0)) is None


def test_a_difference_is_in_units_of_its_own_error() -> None:
    # (10 - 15) / √(3² + 4²) = -1.
    assert difference_in_errors(Estimate(10.0, 3.0), Estimate(15.0, 4.0)) == -1.0
