"""Metrics thinned for pictures."""

import math
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from api import curve_cache
from api import curves as curves_module
from api.curves import extremes, thinned
from api.routes import metrics
from core.jobs import columns, feeds
from core.jobs.curves import Curves
from core.jobs.measured import Measured, StepValues
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


def test_metrics_of_one_moment_share_a_row_and_others_do_not() -> None:
    said = [StepValues(5, {"a": 1.0, "b": 2.0}), StepValues(6, {"b": None})]
    curves = Curves.of(Measured(0.0, one) for one in said)
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


def test_new_values_join_those_that_were_read_before(stack: Stack, attempt: Attempt) -> None:
    attempt.say("metrics", step=0, values={"a": 1.0})
    assert len(rows(stack, attempt, points=4, metric="a")) == 1
    attempt.say("metrics", step=10, values={"a": 2.0, "b": 3.0})
    assert [row["values"] for row in rows(stack, attempt, points=4, metric="a")] == [{"a": 1.0}, {"a": 2.0}]
    # Another metric was not kept at first, and is read from the beginning.
    assert [row["values"] for row in rows(stack, attempt, points=4, metric="b")] == [{"b": 3.0}]
    assert [row["values"] for row in rows(stack, attempt, points=4)] == [{"a": 1.0}, {"a": 2.0, "b": 3.0}]


def test_a_run_in_the_object_store_is_drawn_from_columns_with_the_same_points(
    stack: Stack, attempt: Attempt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feeds, "MAX_BYTES", 1)
    monkeypatch.setattr(feeds, "_MAX_ENTRIES", 10)
    values = [{"a": float(step * 7 % 13), "b": None if step % 5 else 1.0} for step in range(100)]
    attempt.say_all("metrics", [{"step": step, "values": each} for step, each in enumerate(values)])
    from_record = rows(stack, attempt, points=20)
    assert len(from_record) > 20

    while feeds.compact(store=stack.store, objects=stack.objects):
        pass

    def rows_of_a_fresh_process() -> list[dict[str, Any]]:
        stack.service.curves = curve_cache.CurveCache(stack.store, stack.objects)
        return rows(stack, attempt, points=20)

    [stored] = stack.objects.list(f"jobs/{attempt.id}/columns/")
    # 102 entries in 11 chunks: the lines of the first eight are not read.
    first = stack.store.chunks([attempt.id])[attempt.id][: columns.GROUP]
    bodies = {chunk.key: stack.objects.get(chunk.key) for chunk in first}
    for key in bodies:
        stack.objects.delete_prefix(key)
    assert rows_of_a_fresh_process() == from_record
    # Without the columns, they are.
    for key, body in bodies.items():
        stack.objects.put(key, body)
    stack.objects.delete_prefix(stored.key)
    assert rows_of_a_fresh_process() == from_record


def test_next_of_a_thinned_answer_is_where_the_events_continue(stack: Stack, attempt: Attempt) -> None:
    attempt.say("metrics", step=0, values={"a": 1.0})
    here = f"/jobs/{attempt.id}/metrics"
    after = stack.http.get(here, params={"points": 4}).json()["next"]
    attempt.say("metrics", step=10, values={"a": 2.0})
    assert [row["step"] for row in stack.http.get(here, params={"after": after}).json()["rows"]] == [10]


def test_curves_that_find_no_room_are_read_again(
    stack: Stack, attempt: Attempt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(curve_cache, "_MAX_VALUES", 1)
    attempt.say_all("metrics", [{"step": step, "values": {"a": 1.0}} for step in range(3)])
    for _ in range(2):
        assert len(rows(stack, attempt, points=4)) == 3
        assert not stack.service.curves._known  # H3: the last one stayed, however large.


def test_long_feeds_are_read_in_turn_and_a_short_one_at_once(
    stack: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feeds, "METRICS_PAGE", 8)
    first, second, short = (Attempt(stack, job(f"00000000000{n}-0000000000")) for n in range(3))
    for attempt, length in ((first, 20), (second, 20), (short, 1)):
        attempt.say_all("metrics", [{"step": step, "values": {"a": 1.0}} for step in range(length)])
    cache = curve_cache.CurveCache(stack.store, stack.objects)
    inside, entered, overlapped = set[str](), threading.Event(), threading.Event()
    short_is_read = threading.Event()
    read_metrics = feeds.read_metrics

    def reading(job_id: str, after: int, *rest: Any, **stores: Any) -> feeds.MetricsPage:
        if after == 0:
            return read_metrics(job_id, after, *rest, **stores)
        inside.add(job_id)
        entered.set()
        assert short_is_read.wait(10)
        if len(inside) > 1 or overlapped.wait(0.1):  # The other thread has the time to come beside this one.
            overlapped.set()
        page = read_metrics(job_id, after, *rest, **stores)
        inside.remove(job_id)
        return page

    def num_values(attempt: Attempt) -> int:
        with cache.curves(attempt.id, None) as (curves, _):
            return len(curves["a"])

    monkeypatch.setattr(feeds, "read_metrics", reading)
    with ThreadPoolExecutor(2) as pool:
        long = [pool.submit(num_values, attempt) for attempt in (first, second)]
        assert entered.wait(10)
        assert num_values(short) == 1  # Although a page of a long feed is being read.
        short_is_read.set()
        assert [future.result() for future in long] == [20, 20]
    assert not overlapped.is_set()


def test_names_count_in_the_room_of_curves(
    stack: Stack, attempt: Attempt, monkeypatch: pytest.MonkeyPatch
) -> None:
    """H3: only values were counted, and a name takes as much as 33 of them."""
    monkeypatch.setattr(curve_cache, "_MAX_VALUES", 500)
    attempt.say("metrics", step=0, values={f"m{number}": 1.0 for number in range(20)})
    assert len(rows(stack, attempt, points=4)[0]["values"]) == 20
    assert not stack.service.curves._known


def test_many_metrics_get_fewer_points_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """10,000 points of each of 2,000 metrics were one answer."""
    measured = [Measured(float(n), StepValues(n, {f"m{k}": float(n) for k in range(5)})) for n in range(100)]
    assert len(thinned(Curves.of(measured), 50)) > 40
    monkeypatch.setattr(curves_module, "MOST_VALUES", 50)
    assert sum(len(row.values) for row in thinned(Curves.of(measured), 50)) == 50
    assert len(thinned(Curves.of(measured), 50, ["m1"])) > 40


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
