"""A training rate from the points that a trainer reports."""

import pytest

from bench.measure.comparison import rate


def test_a_rate_is_of_the_second_half() -> None:
    # 100 steps took 50 s, compilation in them; the other 100 took 10 s.
    assert rate([(50, 40.0), (100, 50.0), (200, 60.0)]) == 10.0


def test_a_rate_begins_at_the_first_point_in_the_second_half() -> None:
    # Half of 200 lies between 90 and 120: (200 - 120) steps in (60 - 50) s.
    assert rate([(90, 40.0), (120, 50.0), (200, 60.0)]) == 8.0


def test_a_rate_goes_back_to_the_report_before_the_last() -> None:
    # Nothing was reported between the first update and the end: 110 steps in 11 s.
    assert rate([(10, 40.0), (120, 51.0)]) == 10.0


def test_one_point_has_no_rate() -> None:
    with pytest.raises(ValueError, match="second half"):
        rate([(100, 10.0)])
