"""`gaitway usage`: what projects and users have used."""

import re
from datetime import UTC, datetime, timedelta
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from gaitway.cli.common import AsJson, client_of, print_json, size, wrong_usage
from gaitway.cli.terminal import Console
from gaitway.schema import ProjectUsageView

_UNITS = {"h": timedelta(hours=1), "d": timedelta(days=1), "w": timedelta(weeks=1)}


def usage(
    context: typer.Context,
    since: Annotated[
        str, typer.Option(metavar="WHEN", help="How long ago, such as 12h, 7d or 4w; or a date, 2026-11-20.")
    ] = "1d",
    as_json: AsJson = False,
) -> None:
    """Show what each project and user has used: hours of GPUs and of all workers, and the bytes stored."""
    found = client_of(context).usage(_moment(since))
    if as_json:
        print_json(found)
        return
    print(f"Since {found.since.astimezone():%Y-%m-%d %H:%M}:")
    if not found.projects:
        print("Nothing was used.")
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("PROJECT", overflow="fold")
    table.add_column("USER", overflow="fold")
    for column in ("GPU HOURS", "HOURS", "ATTEMPTS", "JOBS ENDED", "RUNNING", "QUEUED", "STORED"):
        table.add_column(column, justify="right")
    for used in found.projects:
        table.add_row(*map(Text, _row(used)))
    Console().print(table)


def _row(used: ProjectUsageView) -> tuple[str, ...]:
    hours = (f"{seconds / 3600:,.2f}" for seconds in (used.gpu_seconds, used.seconds))
    numbers = map(str, (used.attempts, used.jobs, used.running, used.queued))
    return (used.project, used.owner or "–", *hours, *numbers, size(used.bytes))


def _moment(text: str) -> datetime:
    if match := re.fullmatch(r"(\d{1,5})([hdw])", text):
        return datetime.now(UTC) - int(match[1]) * _UNITS[match[2]]
    try:
        return datetime.fromisoformat(text).astimezone()
    except (ValueError, OverflowError):
        raise wrong_usage(f"--since {text}: write 12h, 7d or 4w, or a date such as 2026-11-20.") from None
