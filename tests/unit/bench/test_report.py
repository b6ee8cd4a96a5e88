"""Results as JSON and as tables."""

from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from bench.__main__ import MODULES, PAGE
from bench.measure import charts, report
from bench.measure.machine import Machine, this_machine
from bench.measure.result import Bars, Figure, Line, Panel, Picture, Result, Table, at_least, at_most, below
from bench.measure.statistics import Estimate, Spread

MACHINE = Machine(
    processor="A processor",
    cores=2,
    memory_gib=8.0,
    system="Linux x86_64",
    python="3.11.9",
    packages={"jax": "0.10.2"},
    commit="abc1234",
    load_before=0.1,
    measured_at="2026-11-21T04:00:00+00:00",
)


def result_of(*figures: Figure, name: str = "physics", quick: bool = False) -> Result:
    return Result(
        name=name,
        title="A bench",
        command=f"./run bench {name}",
        quick=quick,
        machine=MACHINE,
        figures=list(figures),
        rows=[{"round": 0, "value": 1.5, "what": None}],
        notes=["A note."],
    )


SLOW = Figure.of("speed", Spread(0.5, 0.25, 0.75), "×", at_least(0.85))
FAST = Figure(name="wait", value=12345.6, unit="s")


def page_with(*names: str) -> str:
    return "\n".join(
        f"# {name}\n{report.begin(name)}\nold\n{report.end(name)}\nafter {name}" for name in names
    )


@pytest.mark.parametrize(
    ("target", "value", "met"),
    [
        (at_least(2), 2.0, True),
        (at_least(2), 1.99, False),
        (at_most(2), 2.0, True),
        (at_most(2), 2.01, False),
        (below(2), 2.0, False),
        (below(2), 1.99, True),
    ],
)
def test_a_target_says_whether_its_own_value_counts(target: object, value: float, met: bool) -> None:
    assert Figure(name="f", value=value, unit="", target=target).met is met  # pyright: ignore[reportArgumentType]


def test_a_figure_without_a_target_is_neither_met_nor_missed() -> None:
    assert FAST.met is None
    assert report.cells(FAST) == ("wait", "12,346 s", "", "", "")


def test_a_missed_target_is_called_missed() -> None:
    assert report.cells(SLOW) == ("speed", "0.5 ×", "0.25 – 0.75", "at least 0.85", "**missed**")
    output = StringIO()
    report.show(result_of(SLOW), Console(file=output, width=200))
    assert "missed" in output.getvalue()
    assert "**" not in output.getvalue()


def test_a_result_comes_back_from_its_file(tmp_path: Path) -> None:
    result = result_of(SLOW, FAST)
    assert result.save(tmp_path / "new").name == "physics.json"
    assert report.load(tmp_path / "new") == [result]


def test_only_the_section_of_a_result_is_renewed() -> None:
    page = report.filled(page_with("physics", "video"), [result_of(SLOW)])

    assert page.count("old") == 1  # the video's
    assert "| speed | 0.5 × | 0.25 – 0.75 | at least 0.85 | **missed** |" in page
    assert "- A note." in page
    assert "after physics" in page
    assert report.filled(page, [result_of(SLOW)]) == page


def test_a_backslash_in_a_name_stays_as_it_is() -> None:
    odd = Figure(name=r"a\1|b", value=1, unit="")
    assert r"| a\1\|b | 1 |" in report.filled(page_with("physics"), [result_of(odd)])


@pytest.mark.parametrize("page", ["", page_with("physics") * 2])
def test_a_page_without_exactly_one_place_is_refused(page: str) -> None:
    with pytest.raises(ValueError, match=r"places for 'physics'"):
        report.filled(page, [result_of(FAST)])


def test_a_smoke_test_never_reaches_the_page() -> None:
    with pytest.raises(ValueError, match="smoke test"):
        report.filled(page_with("physics"), [result_of(FAST, quick=True)])


def test_the_performance_page_has_a_place_for_every_bench() -> None:
    page = Path(__file__).parents[3].joinpath(PAGE).read_text()
    for name in MODULES:
        assert report.filled(page, [result_of(FAST, name=name)])


def test_the_machine_knows_itself() -> None:
    machine = this_machine()
    assert machine.cores >= 1
    assert machine.packages["jax"]


def test_a_mean_is_shown_with_its_standard_error() -> None:
    mean = Figure.of_mean("return", Estimate(2865.0, 65.6), "")
    assert report.cells(mean) == ("return", "2,865", "± 65.6", "", "")


def test_what_was_not_measured_is_missed_and_its_reason_told() -> None:
    missing = Figure(name="gain", value=None, unit="×", target=at_least(2), missing="it crashed")
    assert missing.met is False
    page = report.markdown(result_of(missing))
    assert "| gain | not measured |  | at least 2 | **missed** |" in page
    assert "- Not measured: gain (it crashed)." in page


def test_a_table_and_pictures_come_before_the_figures() -> None:
    result = result_of(FAST).model_copy(
        update={"table": Table(headings=["Body", "Rate"], rows=[["ant", "1"]]), "pictures": [PICTURE]}
    )
    page = report.markdown(result)
    assert "![What it shows](pictures/bench-speed.png)" in page
    assert page.index("bench-speed.png") < page.index("| ant | 1 |") < page.index("| wait |")
    output = StringIO()
    report.show(result, Console(file=output, width=200))
    assert "ant" in output.getvalue()


def test_a_picture_is_drawn_where_the_page_looks_for_it(tmp_path: Path) -> None:
    (path,) = charts.draw([result_of(FAST).model_copy(update={"pictures": [PICTURE]})], tmp_path / "new")
    assert path == tmp_path / "new" / "bench-speed.png"
    assert path.read_bytes().startswith(b"\x89PNG")


PICTURE = Picture(
    name="speed",
    caption="What it shows",
    panels=[
        Panel(title="t", x="steps", y="return", lines=[Line(label="ours", points=[(0, 1), (10, 2)])] * 2),
        Bars(
            title="b", unit="s", groups=["ant", "humanoid"], series={"warp": [1.0, None], "mjx": [2.0, 3.0]}
        ),
        Bars(title="b", unit="s", groups=["ant"], series={"training": [1.0], "rest": [-0.1]}, stacked=True),
    ],
)
