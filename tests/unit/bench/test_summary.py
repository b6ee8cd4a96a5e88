"""The figures of a bench: their targets, their statistics, and the file that keeps them."""

import json
from pathlib import Path

import pytest
from rich.console import Console

from bench.summary import MOST_LINES, Figure, Run, middle, percentile, save, show

RESULTS = sorted((Path(__file__).parents[3] / "bench" / "results").glob("*.json"))


def run(command: str, date: str, *figures: Figure) -> Run:
    return Run(command, date, "0123abc", "two cores", figures)


@pytest.mark.parametrize(
    ("figure", "target", "met"),
    [
        (Figure("rate", 3.0, "steps/s"), "", None),
        (Figure("rate", 3.0, at_least=3.0), "≥ 3", True),
        (Figure("rate", 2.9, at_least=3.0), "≥ 3", False),
        (Figure("wait", 25.0, "ms", at_most=25.0), "≤ 25", True),
        (Figure("wait", 25.1, "ms", at_most=25.0), "≤ 25", False),
        (Figure("lost", 0, at_most=0), "≤ 0", True),
        (Figure("wait", None, "ms", at_most=25.0, missing="it failed"), "≤ 25", False),
    ],
)
def test_a_figure_meets_its_target_or_misses_it(figure: Figure, target: str, met: bool | None) -> None:
    assert (figure.target, figure.met) == (target, met)


def test_the_middle_of_rounds_has_their_range() -> None:
    assert middle("wait", [3.0, 1.0, 2.0], "s") == Figure("wait", 2.0, "s", 1.0, 3.0)
    assert middle("wait", [3.0], "s") == Figure("wait", 3.0, "s")
    assert middle("wait", [], "s", at_most=1, missing="none came").met is False


def test_a_percentile_is_one_of_the_values() -> None:
    values = [float(value) for value in range(1, 201)]
    assert [percentile(values, percent) for percent in (0.1, 50, 99, 100)] == [1, 100, 198, 200]
    with pytest.raises(ValueError, match="nothing"):
        percentile([], 50)


def test_a_run_replaces_the_last_one_of_its_command_alone(tmp_path: Path) -> None:
    save(tmp_path, "physics", run("./run bench physics", "2026-01-01", Figure("rate", 1.0)))
    save(tmp_path, "physics", run("./run bench physics --gpu", "2026-01-02", Figure("rate", 2.0)))
    path = save(tmp_path, "physics", run("./run bench physics", "2026-01-03", Figure("rate", 3.0)))
    document = json.loads(path.read_text())
    assert document["bench"] == "physics"
    assert [(one["date"], one["figures"][0]["value"]) for one in document["runs"]] == [
        ("2026-01-02", 2.0),
        ("2026-01-03", 3.0),
    ]
    assert document["runs"][0]["commit"], document["runs"][0]["machine"]


def test_the_oldest_runs_go_where_the_file_would_be_too_long(tmp_path: Path) -> None:
    figures = [Figure(f"rate {number}", 1234.56) for number in range(20)]
    for day in range(1, 8):
        save(tmp_path, "train", run(f"./run bench train {day}", f"2026-01-0{day}", *figures))
    path = tmp_path / "train.json"
    runs = json.loads(path.read_text())["runs"]
    assert len(path.read_text().splitlines()) <= MOST_LINES
    assert [one["date"] for one in runs] == [f"2026-01-0{day}" for day in (4, 5, 6, 7)]
    assert runs[0]["figures"][0]["value"] == 1235


@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_a_committed_summary_says_where_each_figure_is_from(path: Path) -> None:
    document = json.loads(path.read_text())
    assert document["bench"] == path.stem
    assert len(path.read_text().splitlines()) <= MOST_LINES
    for one in document["runs"]:
        assert one["figures"]
        assert all(one[name] for name in ("command", "date", "commit", "machine"))


def test_a_table_calls_a_missed_target_missed() -> None:
    console = Console(record=True, width=150)
    figures = (Figure("wait", 25.1, "ms", at_most=25), Figure("rate", None, missing="it failed"))
    show("service", run("./run bench service", "2026-01-01", *figures), console)
    printed = console.export_text()
    for text in ("25.1 ms", "≤ 25", "missed", "it failed", "commit 0123abc", "two cores"):
        assert text in printed
