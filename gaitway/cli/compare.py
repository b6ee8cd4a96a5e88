"""`gaitway compare`: several jobs side by side, and only what differs of their settings."""

import csv
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, cast

import typer
from rich.table import Table
from rich.text import Text

from gaitway.cli.common import AsJson, client_of, job_id, print_json, wrong_usage
from gaitway.cli.progress import duration
from gaitway.cli.terminal import Console
from gaitway.client import Client
from gaitway.schema import JobView

# The first of each that a job measured: an evaluation goes before the training's own numbers.
_METRICS = {
    "return": ("eval/episode_reward", "training/episode_reward"),
    "speed in m/s": ("eval/forward_speed", "training/forward_speed"),
}
_NAMES = [name for names in _METRICS.values() for name in names]
# The service keeps each metric's last value, and the least and greatest of each part.
_POINTS = 4
_MOST = 20

Cell = str | int | float | bool | None
Rows = dict[str, list[Cell]]


@dataclass(frozen=True)
class Compared:
    """A job, its settings by their path, and its values of the metrics above, oldest first."""

    job: JobView
    settings: Mapping[str, Cell]
    values: Mapping[str, Sequence[float]]

    @classmethod
    def of(cls, client: Client, full_id: str) -> "Compared":
        job = client.get(full_id)
        rows = client.metrics(full_id, names=_NAMES, points=_POINTS)
        values = {
            name: [value for row in rows if (value := row.values.get(name)) is not None] for name in _NAMES
        }
        return cls(job, dict(flat(client.specification(full_id))), values)

    def facts(self) -> dict[str, Cell]:
        """The job's result; None where it has no such number."""
        facts: dict[str, Cell] = {"status": self.job.status}
        for label, names in _METRICS.items():
            found = next((self.values[name] for name in names if self.values[name]), None)
            facts[f"last {label}"] = found[-1] if found else None
            facts[f"best {label}"] = max(found) if found else None
        facts["steps"] = self.job.progress.step
        facts["seconds"] = self._seconds()
        facts["steps/s"] = self.job.progress.steps_per_second
        return facts

    def _seconds(self) -> float | None:
        if self.job.started_at is None:
            return None
        return round(((self.job.finished_at or datetime.now(UTC)) - self.job.started_at).total_seconds(), 1)


def compare(
    context: typer.Context,
    jobs: Annotated[
        list[str], typer.Argument(metavar="JOB JOB [JOB …]", help="Ids, as the other commands take them.")
    ],
    as_csv: Annotated[bool, typer.Option("--csv", help="Print CSV, a line for each fact.")] = False,
    as_json: AsJson = False,
) -> None:
    """Compare jobs: what they came to, and the settings in which they differ."""
    client = client_of(context)
    ids = list(dict.fromkeys(job_id(client, name) for name in jobs))
    if not 2 <= len(ids) <= _MOST:
        raise wrong_usage(f"Name from 2 to {_MOST} different jobs; these are {len(ids)}.")
    compared = [Compared.of(client, full_id) for full_id in ids]
    facts, settings = (
        _by_row([one.facts() for one in compared]),
        differing([one.settings for one in compared]),
    )
    if as_json:
        print_json({"jobs": ids, "facts": facts, "settings": settings})
    elif as_csv:
        _print_csv(ids, facts, settings)
    else:
        _print_table(compared, facts, settings)


def differing(settings: Sequence[Mapping[str, Cell]]) -> Rows:
    """Settings by their path, each with the value of every job; only those in which the jobs differ."""
    rows = _by_row(settings)
    return {path: cells for path, cells in rows.items() if len({json.dumps(cell) for cell in cells}) > 1}


def flat(document: Any) -> Iterator[tuple[str, Cell]]:
    """Every setting with its path; a list is one setting, as JSON."""
    for path, value in leaves(document):
        yield path, json.dumps(value) if isinstance(value, list) else value


def leaves(document: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every setting with its path; a list is one setting."""
    if isinstance(document, dict):
        for name, value in cast("dict[str, Any]", document).items():
            yield from leaves(value, f"{path}.{name}" if path else name)
    else:
        yield path, document


def _by_row(columns: Sequence[Mapping[str, Cell]]) -> Rows:
    names = dict.fromkeys(name for column in columns for name in column)
    return {name: [column.get(name) for column in columns] for name in names}


def _print_csv(ids: Sequence[str], facts: Rows, settings: Rows) -> None:
    writer = csv.writer(sys.stdout, lineterminator="\n")  # a carriage return would be replaced
    writer.writerow(["", *ids])
    for rows in (facts, settings):
        writer.writerows([name, *map(_field, cells)] for name, cells in rows.items())


def _field(cell: Cell) -> Cell:
    """A name that a spreadsheet would run as a formula gets an apostrophe in front, as on the page."""
    return f"'{cell}" if isinstance(cell, str) and cell.startswith(("=", "+", "-", "@", "\t", "\r")) else cell


def _print_table(compared: Sequence[Compared], facts: Rows, settings: Rows) -> None:
    table = Table(box=None, pad_edge=False)
    table.add_column("", overflow="fold")  # Cut, the names of two settings may look the same.
    for one in compared:
        name = f"{one.job.name}\n" if one.job.name else ""
        table.add_column(Text(f"{name}{one.job.id}"), overflow="fold")
    for name, cells in facts.items():
        if any(cell is not None for cell in cells):
            table.add_row(name, *(Text(_shown(name, cell)) for cell in cells))
    table.add_section()
    for path, cells in settings.items():
        table.add_row(path, *(Text("–" if cell is None else str(cell)) for cell in cells))
    console = Console()
    console.print(table)
    if not settings:
        console.print("All settings are the same.")


def _shown(name: str, cell: Cell) -> str:
    if name == "seconds" and isinstance(cell, float):
        return duration(cell)
    if isinstance(cell, int):
        return f"{cell:,}"
    if isinstance(cell, float):
        return f"{cell:,.0f}" if abs(cell) >= 1000 else f"{cell:.4g}"
    return "–" if cell is None else cell
