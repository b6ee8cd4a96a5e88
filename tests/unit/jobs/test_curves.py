"""Curves in memory, and as bytes."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from core.jobs.curves import Curve, Curves, decode, encode
from core.jobs.measured import Measured, StepValues

# Steps that often begin again, metrics that are often missing, and values that are not finite.
VALUES = st.dictionaries(st.sampled_from("abc"), st.none() | st.floats(allow_nan=False))
MEASURED = st.lists(
    st.builds(
        Measured, st.floats(0, 2e9), st.builds(StepValues, st.integers(0, 9) | st.integers(0, 2**53), VALUES)
    )
)


def test_a_range_of_steps_includes_both_ends() -> None:
    curve = Curve()
    for step in (0, 10, 20, 30):
        curve.add(step, float(step), 0.0)
    assert list(curve.between(10, 20)) == [1, 2]
    assert list(curve.between(11, None)) == [2, 3]
    assert list(curve.between(None, 9)) == [0]
    assert list(curve.between(31, 5)) == []


def test_an_attempt_that_begins_again_replaces_what_followed() -> None:
    curve = Curve()
    for step, value in [(0, 1.0), (10, 2.0), (20, 3.0), (10, 2.5)]:
        curve.add(step, float(step), value)
    assert (list(curve.steps), list(curve.values)) == ([0, 10], [1.0, 2.5])


@given(MEASURED, st.lists(st.integers(0, 30)))
def test_parts_in_their_order_give_the_whole(measured: list[Measured], cuts: list[int]) -> None:
    bounds = [0, *sorted(min(cut, len(measured)) for cut in cuts), len(measured)]
    joined = Curves()
    for start, end in pairwise(bounds):
        joined.extend(Curves.of(measured[start:end]))
    assert encode(joined) == encode(Curves.of(measured))


@given(MEASURED)
def test_bytes_hold_every_number_and_give_only_the_metrics_that_were_asked_for(
    measured: list[Measured],
) -> None:
    curves = Curves.of(measured)
    found = decode(encode(curves))
    assert found is not None
    assert list(found) == list(curves)
    assert repr(found) == repr(curves)  # nan differs from itself.
    some = decode(encode(curves), {"a", "z"})
    assert repr(some) == repr({name: curve for name, curve in curves.items() if name == "a"})


def test_metrics_that_are_measured_together_share_their_steps_and_times() -> None:
    curves = Curves.of(Measured(0.0, StepValues(step, {"a": 1.0, "b": None})) for step in range(1000))
    # Steps, times, and two values of 8 bytes for each row, behind a digest of 32 bytes.
    assert 4 * 8000 < len(encode(curves)) < 4 * 8000 + 200


def test_a_bit_that_is_flipped_anywhere_is_seen() -> None:
    body = encode(Curves.of([Measured(0.0, StepValues(1, {"a": 1.0}))]))
    for place in range(len(body)):
        assert decode(body[:place] + bytes([body[place] ^ 1]) + body[place + 1 :]) is None
    assert decode(b"") is None
