"""Metrics in columns: rows, their bytes, the newest of them, and curves."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from core.jobs.metrics import Block, Curve, Curves, Measurement, Newest

# Steps that often begin again, metrics that are often missing, and values that are not finite.
VALUES = st.dictionaries(st.sampled_from("abc"), st.none() | st.floats(allow_nan=False, allow_infinity=False))
SAID = st.lists(st.tuples(st.integers(0, 9) | st.integers(0, 2**53), st.floats(0, 2e9), VALUES))
ROWS = SAID.map(lambda said: [Measurement(number, *one) for number, one in enumerate(said, 7)])


def curves_of(*blocks: Block) -> Curves:
    curves = Curves()
    for block in blocks:
        curves.extend(block)
    return curves


def row(number: int, step: int, **values: float | None) -> Measurement:
    return Measurement(number, step, float(number), values)


@given(ROWS, st.integers(0, 20))
def test_a_block_gives_its_rows_back_in_their_order_also_as_bytes(
    rows: list[Measurement], after: int
) -> None:
    block = Block.of(rows)
    assert list(block.rows()) == rows
    assert (block.first, block.last) == ((rows[0].number, rows[-1].number) if rows else (0, 0))
    stored = Block.decode(block.encode(), block.first)
    assert list(stored.rows()) == rows
    assert list(stored.after(after).rows()) == [one for one in rows if one.number > after]
    lines = [(one.number, one.step, one.time, one.values.get("z"), one.values.get("a")) for one in rows]
    assert list(block.lines(["z", "a"])) == lines


@given(ROWS)
def test_of_bytes_only_the_metrics_that_are_asked_for_are_read(rows: list[Measurement]) -> None:
    block = Block.of(rows)
    some = curves_of(Block.decode(block.encode(), block.first, {"a", "z"}))
    assert repr(some) == repr({name: curve for name, curve in curves_of(block).items() if name == "a"})


@given(ROWS, st.lists(st.integers(0, 30)))
def test_parts_in_their_order_give_the_whole(rows: list[Measurement], cuts: list[int]) -> None:
    bounds = [0, *sorted(min(cut, len(rows)) for cut in cuts), len(rows)]
    parts = [Block.of(rows[start:end]) for start, end in pairwise(bounds)]
    joined = Block()
    for part in parts:
        joined.extend(part)
    assert list(joined.rows()) == rows
    whole = dict(sorted(curves_of(Block.of(rows)).items()))
    assert repr(dict(sorted(curves_of(*parts).items()))) == repr(whole)  # nan differs from itself.


def test_metrics_that_are_measured_together_share_their_steps_and_times() -> None:
    block = Block.of(row(step, step, a=1.0, b=None) for step in range(1000))
    # Numbers, steps, times, and two values: 8 bytes each for a row.
    assert 5 * 8000 < len(block.encode()) < 5 * 8000 + 200


@given(ROWS)
def test_of_rows_with_the_same_step_and_names_the_newest_counts(rows: list[Measurement]) -> None:
    cut = len(rows) // 2
    blocks = [Block.of(rows[:cut]), Block.of(rows[cut:])]
    newest = Newest(blocks)
    last = {(one.step, frozenset(one.values)): one for one in rows}
    assert [one for block in blocks for one in newest.of(block).rows()] == sorted(last.values())
    assert newest.names == {name for one in rows for name in one.values}


def test_rows_that_came_after_all_that_were_seen_do_not_count() -> None:
    newest = Newest([Block.of([row(1, 1, a=1.0)])])
    assert list(newest.of(Block.of([row(1, 1, a=1.0), row(2, 2, a=2.0)])).rows()) == [row(1, 1, a=1.0)]


def test_a_range_of_steps_includes_both_ends() -> None:
    curve = curves_of(Block.of(row(step, step, a=0.0) for step in (0, 10, 20, 30)))["a"]
    assert list(curve.between(10, 20)) == [1, 2]
    assert list(curve.between(11, None)) == [2, 3]
    assert list(curve.between(None, 9)) == [0]
    assert list(curve.between(31, 5)) == []


def test_an_attempt_that_begins_again_replaces_what_followed() -> None:
    said = [(0, 1.0), (10, 2.0), (20, 3.0), (10, 2.5)]
    curve: Curve = curves_of(Block.of(row(at, step, a=value) for at, (step, value) in enumerate(said)))["a"]
    assert (list(curve.steps), list(curve.values)) == ([0, 10], [1.0, 2.5])
