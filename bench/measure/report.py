"""Tables from results: on the terminal, and between the markers of docs/performance.md."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown
from rich.table import Table

from bench.measure.charts import file_name
from bench.measure.result import Figure, Result

HEADINGS = ("Figure", "Measured", "Lowest – highest, or ± error", "Target", "")


def begin(name: str) -> str:
    return f"<!-- bench {name}: begin -->"


def end(name: str) -> str:
    return f"<!-- bench {name}: end -->"


def number(value: float) -> str:
    """Three significant digits or more, thousands apart."""
    if value == 0:
        return "0"
    if abs(value) >= 1000:
        return f"{value:,.0f}"
    return f"{value:.3g}"


def cells(figure: Figure) -> tuple[str, str, str, str, str]:
    """A figure under HEADINGS; a missed target is called missed."""
    among = (
        "" if figure.low is None or figure.high is None else f"{number(figure.low)} – {number(figure.high)}"
    )
    if figure.error is not None:
        among = f"± {number(figure.error)}"
    measured = "not measured" if figure.value is None else f"{number(figure.value)} {figure.unit}".strip()
    target = "" if figure.target is None else f"{figure.target.comparison} {number(figure.target.value)}"
    verdict = {True: "met", False: "**missed**", None: ""}[figure.met]
    return figure.name, measured, among, target, verdict


def show(result: Result, console: Console) -> None:
    """The table and the notes, on a terminal."""
    table = Table(*HEADINGS, title=result.title, title_justify="left")
    for figure in result.figures:
        *texts, verdict = cells(figure)
        colour = "red" if figure.met is False else "green"
        table.add_row(*texts, f"[{colour}]{verdict.strip('*')}[/]" if verdict else "")
    if result.table is not None:
        console.print(Markdown("\n".join(_table(result.table.headings, result.table.rows))))
    if result.figures:
        console.print(table)
    if result.quick:
        console.print("A smoke test of the bench: the numbers say nothing.", style="yellow")
    for note in (*_missing(result), *result.notes):
        console.print(f"- {note}", markup=False)


def markdown(result: Result) -> str:
    """The same as Markdown, with where and when it was measured."""
    machine = result.machine
    accelerator = f"{machine.accelerator}, " if machine.accelerator else ""
    packages = ", ".join(f"{name} {version}" for name, version in machine.packages.items())
    tables = list[list[str]]()
    if result.table is not None:
        tables.append(_table(result.table.headings, result.table.rows))
    if result.figures:
        tables.append(_table(HEADINGS, [cells(figure) for figure in result.figures]))
    lines = [
        *(f"![{one.caption}](pictures/{file_name(one)})\n" for one in result.pictures),
        *(line for table in tables for line in (*table, "")),
        f"`{result.command}` on {machine.measured_at[:10]}, commit {machine.commit}: "
        f"{accelerator}{machine.processor}, {machine.cores} cores, {machine.memory_gib:g} GiB, "
        f"Python {machine.python}, {packages}; "
        f"load {machine.load_before:g} before it began.",
    ]
    if notes := [*_missing(result), *result.notes]:
        lines += ["", *(f"- {note}" for note in notes)]
    return "\n".join(lines)


def filled(page: str, results: Iterable[Result]) -> str:
    """The page with each result's section renewed.

    Raises ValueError for a result of a smoke test, and where the page has no place for a result.
    """
    for result in results:
        if result.quick:
            raise ValueError(f"{result.name}.json is of a smoke test (--quick); measure it in earnest first.")
        place = re.compile(f"{re.escape(begin(result.name))}.*?{re.escape(end(result.name))}", re.DOTALL)
        section = f"{begin(result.name)}\n{markdown(result)}\n{end(result.name)}"
        page, count = place.subn(lambda _, section=section: section, page)
        if count != 1:
            raise ValueError(f"The page has {count} places for {result.name!r}; there must be one.")
    return page


def load(folder: Path) -> list[Result]:
    """Every result in the folder, by name."""
    return [Result.model_validate_json(path.read_bytes()) for path in sorted(folder.glob("*.json"))]


def _missing(result: Result) -> list[str]:
    """The figures that were not measured, with the reasons."""
    notes = [f"Not measured: {one.name} ({one.missing})." for one in result.figures if one.missing]
    if result.unfinished:
        notes.append(f"Not made yet: {', '.join(result.unfinished)}.")
    return notes


def _table(headings: Sequence[str], rows: Iterable[Iterable[str]]) -> list[str]:
    return [_row(headings), _row("---" for _ in headings), *map(_row, rows)]


def _row(texts: Iterable[str]) -> str:
    return "| " + " | ".join(text.replace("|", "\\|") for text in texts) + " |"
