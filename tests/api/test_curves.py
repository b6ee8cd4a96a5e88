"""Metrics thinned for pictures."""

import csv
import io
import math
from datetime import datetime
from typing import Any

import pytest

from api import curves as curves_module
from api.curves import csv_lines, extremes, thinned
from api.routes import metrics
from core.jobs import feeds
from core.jobs.metrics import Block, Curves, Measurement, Newest
from tests.api.conftest import Attempt, Stack, job
from tests.api.problems import pointers, problem


@pytest.fixture
def attempt(stack: Stack) -> Attempt:
    return Attempt(stack, job())


def test_few_values_stay_as_they_are() -> None:
    assert extremes([3.0, 1.0, 2.0, 5.0], range(4), 4) == [0, 1, 2, 3]


def test_each_part_keeps_its_least_and_its_greatest() -> None:
    # 6 points of 10: the first, the last, and two of each half of the 8 between: places 1 to 4 and 5 to 8.
    #         0    1    2    3    4    5    6    7    8    9
    values = [0.0, 5.0, 9.0, 2.0, 4.0, 3.0, 3.0, 8.0, 1.0, 0.0]
    # In 5 9 2 4 the greatest stands at 2, the least at 3; in 3 3 8 1 they stand at 7 and 8.
    assert extremes(values, range(10), 6) == [0, 2, 3, 7, 8, 9]


def test_a_part_of_one_value_keeps_it_once() -> None:
    # 7 points leave two parts for the 6 values between: 1 1 1 and 4 6 5. In equal values the first counts.
    assert extremes([0.0, 1.0, 1.0, 1.0, 4.0, 6.0, 5.0, 9.0], range(8), 7) == [0, 1, 4, 5, 7]


def test_a_value_that_is_no_number_hides_no_other() -> None:
    values = [0.0, math.nan, 2.0, 7.0, math.nan, math.nan, math.nan, 1.0]
    # Parts nan 2 7 and nan nan nan: of the second one a place stays, so that the curve has a gap there.
    assert extremes(values, range(8), 6) == [0, 2, 3, 4, 7]


def test_every_number_of_a_table_is_read_back_as_it_was() -> None:
    name, values = 'a "quoted", name', [0.1, -1e-300, 1.7e308, 1e16, -0.0, 5.0, math.nan, 2 / 3]
    block = Block.of(
        Measurement(number, 10**18 + number, 1.5 + number, {name: value})
        for number, value in enumerate(values)
    )
    text = b"".join(csv_lines([block], Newest([block]))).decode()
    head, *rows = csv.reader(io.StringIO(text, newline=""))
    assert head == ["step", "time", name]
    assert [float(cell) if cell else None for *_, cell in rows] == [None if v != v else v for v in values]
    assert [int(step) for step, *_ in rows] == [10**18 + number for number in range(8)]
    assert [datetime.fromisoformat(time).timestamp() for _, time, _ in rows] == [1.5 + n for n in range(8)]


def test_metrics_of_one_moment_share_a_row_and_others_do_not() -> None:
    curves = Curves()
    curves.extend(
        Block.of([Measurement(1, 5, 0.0, {"a": 1.0, "b": 2.0}), Measurement(2, 6, 0.0, {"b": None})])
    )
    rows = [(row.step, row.values) for row in thinned(curves, 4)]
    assert rows == [(5, {"a": 1.0, "b": 2.0}), (6, {"b": None})]


def rows(stack: Stack, attempt: Attempt, **query: Any) -> list[dict[str, Any]]:
    answer = stack.http.get(f"/jobs/{attempt.id}/metrics", params=query)
    assert answer.status_code == 200, answer.text
    return answer.json()["rows"]


def test_a_long_run_comes_thinned_and_whole_where_one_looks_closely(stack: Stack, attempt: Attempt) -> None:
    said = [{"step": step, "values": {"a": float(step % 100), "b": 0.0}} for step in range(1000)]
    attempt.say_all("metrics", said)
    found = rows(stack, attempt, points=10, metric="a")
    # The first, the last, and two of each of four parts; each part has values from 0 to 99.
    assert [row["step"] for row in (found[0], found[-1])] == [0, 999]
    assert [row["values"]["a"] for row in found[1:-1]].count(99.0) == 4
    assert all(set(row["values"]) == {"a"} for row in found)
    assert len(found) == 10
    close = rows(stack, attempt, points=10, metric="a", first_step=500, last_step=507)
    assert [row["step"] for row in close] == list(range(500, 508))


def test_a_run_in_the_object_store_is_drawn_with_the_same_points(
    stack: Stack, attempt: Attempt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feeds, "MAX_BYTES", 1)
    monkeypatch.setattr(feeds, "MAX_METRICS_BYTES", 1)
    values = [{"a": float(step * 7 % 13), "b": None if step % 5 else 1.0} for step in range(100)]
    said = [{"step": step, "values": each} for step, each in enumerate(values)]
    for start in range(0, 100, 10):
        attempt.say_all("metrics", said[start : start + 10])
    from_record = rows(stack, attempt, points=20)
    assert len(from_record) > 20
    while feeds.compact(store=stack.store, objects=stack.objects):
        pass
    assert len(list(stack.objects.list(f"jobs/{attempt.id}/metrics/"))) == 10
    # The other events are not read.
    stack.objects.delete_prefix(f"jobs/{attempt.id}/events/")
    assert rows(stack, attempt, points=20) == from_record


def test_next_of_a_thinned_answer_is_where_the_events_continue(stack: Stack, attempt: Attempt) -> None:
    attempt.say("metrics", step=0, values={"a": 1.0})
    here = f"/jobs/{attempt.id}/metrics"
    after = stack.http.get(here, params={"points": 4}).json()["next"]
    attempt.say("metrics", step=10, values={"a": 2.0})
    assert [row["step"] for row in stack.http.get(here, params={"after": after}).json()["rows"]] == [10]


def test_many_metrics_get_fewer_points_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """10,000 points of each of 2,000 metrics were one answer."""
    curves = Curves()
    curves.extend(
        Block.of(Measurement(n, n, float(n), {f"m{k}": float(n) for k in range(5)}) for n in range(100))
    )
    assert len(thinned(curves, 50)) > 40
    monkeypatch.setattr(curves_module, "MOST_VALUES", 50)
    assert sum(len(row.values) for row in thinned(curves, 50)) == 50
    assert len(thinned(curves, 50, ["m1"])) > 40


def test_a_page_of_rows_ends_at_a_number_of_values(
    stack: Stack, attempt: Attempt, monkeypatch: pytest.MonkeyPatch
) -> None:
    """H3: 10,000 rows of hundreds of metrics were one answer."""
    monkeypatch.setattr(metrics, "MOST_VALUES", 3 * (7 + 2))
    said = [{"step": step, "values": {"=a": 1.0, "b": 2.0}} for step in range(10)]
    attempt.say_all("metrics", said)
    here, after, steps = f"/jobs/{attempt.id}/metrics", "", list[int]()
    for _ in range(4):
        page = stack.http.get(here, params={"after": after}).json()
        steps += [row["step"] for row in page["rows"]]
        after = page["next"]
    assert steps == list(range(10))
    table = stack.http.get(here, params={"format": "csv", "limit": 5})
    assert len(table.text.splitlines()) == 1 + 3
    assert 'rel="next"' in table.headers["Link"]
    # L8: a spreadsheet would take the name for a formula.
    assert table.text.splitlines()[0] == "step,time,'=a,b"


@pytest.mark.parametrize(
    ("query", "pointer"),
    [
        ({"metric": "a"}, "/metric"),
        ({"first_step": 1}, "/first_step"),
        ({"points": 4, "format": "csv"}, "/format"),
        ({"points": 4, "after": "3"}, "/after"),
        ({"points": 3}, "/points"),
    ],
)
def test_parameters_that_would_have_no_effect_are_refused(
    stack: Stack, attempt: Attempt, query: dict[str, Any], pointer: str
) -> None:
    answer = stack.http.get(f"/jobs/{attempt.id}/metrics", params=query)
    assert pointers(problem(answer, 422, "invalid-request")) == [pointer]


def test_a_deleted_job_has_no_curves_any_more(stack: Stack, attempt: Attempt) -> None:
    attempt.say("metrics", step=0, values={"a": 1.0})
    assert rows(stack, attempt, points=4)
    attempt.end()
    assert stack.http.delete(f"/jobs/{attempt.id}").status_code == 204
    problem(stack.http.get(f"/jobs/{attempt.id}/metrics?points=4"), 404, "job-not-found")
