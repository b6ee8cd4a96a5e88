"""`gaitway retention`: what a project keeps of its ended jobs."""

from collections.abc import Sequence
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from gaitway.cli.common import (
    AsJson,
    Project,
    Yes,
    client_of,
    confirm,
    print_json,
    project_of,
    wrong_usage,
)
from gaitway.cli.terminal import Console
from gaitway.schema import RemovalView, RetentionPreviewView, RetentionView

retention = typer.Typer(help="What a project keeps of its ended jobs.", no_args_is_help=True)
# By the rule's name, what it says of a number.
_SAYS = {
    "checkpoints": "of each job the newest {} checkpoints stay",
    "videos_days": "videos go after {} days",
    "replays_days": "replays and trajectories go after {} days",
    "failed_days": "failed jobs go after {} days, with all that they have",
    "cancelled_days": "cancelled jobs go after {} days, with all that they have",
}
Checkpoints = Annotated[int | None, typer.Option(help="Of each job the newest so many stay.")]
VideosDays = Annotated[int | None, typer.Option(help="Videos go after so many days.")]
ReplaysDays = Annotated[int | None, typer.Option(help="Replays and trajectories go after so many days.")]
FailedDays = Annotated[int | None, typer.Option(help="Failed jobs go after so many days, as a whole.")]
CancelledDays = Annotated[int | None, typer.Option(help="Cancelled jobs go after so many days, as a whole.")]


@retention.command("show")
def show(context: typer.Context, project: Project = None, as_json: AsJson = False) -> None:
    """Show a project's rules."""
    client = client_of(context)
    found = client.retention(project_of(client, project))
    if as_json:
        print_json(found)
    else:
        print(_said(found))


@retention.command("preview")
def preview(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    project: Project = None,
    checkpoints: Checkpoints = None,
    videos_days: VideosDays = None,
    replays_days: ReplaysDays = None,
    failed_days: FailedDays = None,
    cancelled_days: CancelledDays = None,
    limit: Annotated[int, typer.Option("--limit", "-n", min=1, max=200)] = 10,
    as_json: AsJson = False,
) -> None:
    """Show what rules would remove now; without any, what the project's own rules remove next."""
    client = client_of(context)
    inside = project_of(client, project)
    rules = _rules(checkpoints, videos_days, replays_days, failed_days, cancelled_days)
    if not rules:
        found = client.retention(inside)
        if found.set_at is None:
            raise wrong_usage(f"{inside} has no rules: give some, such as --checkpoints 2.")
        rules = found.model_dump(include={*_SAYS})
    seen = client.preview_retention(inside, limit=limit, **rules)
    if as_json:
        print_json(seen)
    else:
        _print(seen)


@retention.command("set")
def set_rules(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    project: Project = None,
    checkpoints: Checkpoints = None,
    videos_days: VideosDays = None,
    replays_days: ReplaysDays = None,
    failed_days: FailedDays = None,
    cancelled_days: CancelledDays = None,
    yes: Yes = False,
) -> None:
    """Show what rules remove, ask, and set them in place of those before. For an admin."""
    client = client_of(context)
    inside = project_of(client, project)
    rules = _rules(checkpoints, videos_days, replays_days, failed_days, cancelled_days)
    if not rules:
        raise wrong_usage("Give a rule, such as --checkpoints 2; `gaitway retention remove` ends all.")
    _print(client.preview_retention(inside, limit=10, **rules))
    confirm(f"Set these rules for {inside}?", yes=yes)
    print(_said(client.set_retention(inside, **rules)))


@retention.command("remove")
def remove(context: typer.Context, project: Project = None) -> None:
    """Keep everything from now on. For an admin."""
    client = client_of(context)
    inside = project_of(client, project)
    client.remove_retention(inside)
    print(f"{inside} keeps everything from now on.")


def _rules(
    checkpoints: int | None,
    videos_days: int | None,
    replays_days: int | None,
    failed_days: int | None,
    cancelled_days: int | None,
) -> dict[str, int]:
    values = (checkpoints, videos_days, replays_days, failed_days, cancelled_days)
    return {rule: value for rule, value in zip(_SAYS, values, strict=True) if value is not None}


def _said(rules: RetentionView) -> str:
    if rules.set_at is None:
        return f"{rules.project} has no rules and keeps everything."
    given = {rule: getattr(rules, rule) for rule in _SAYS}
    parts = [_SAYS[rule].format(value) for rule, value in given.items() if value is not None]
    by = f" by {rules.set_by}" if rules.set_by else ""
    return f"In {rules.project}, {'; '.join(parts)}. Set{by} {rules.set_at.astimezone():%Y-%m-%d %H:%M}."


def _print(seen: RetentionPreviewView) -> None:
    print(f"{_many(seen.jobs, 'job')} would lose {_many(seen.files, 'file')}, {_size(seen.bytes)}.")
    if seen.whole_jobs:
        print(f"{seen.whole_jobs:,} of these jobs would go as a whole.")
    if seen.roles:
        _table(
            ("FILES", "NUMBER", "SIZE"),
            [(one.role, f"{one.files:,}", _size(one.bytes)) for one in seen.roles],
        )
        _table(("JOB", "NAME", "OWNER", "LOSES", "SIZE"), [_row(one) for one in seen.largest])
        if seen.jobs > len(seen.largest):
            print(f"and {seen.jobs - len(seen.largest):,} more.")
    for one in seen.needed:
        who = f"sweep {one.sweep}" if one.sweep else f"job {', '.join(one.needed_by) or 'of another project'}"
        print(f"Something of {one.job} stays: {who} needs it.")
    if seen.num_needed > len(seen.needed):
        print(f"So it is with {seen.num_needed - len(seen.needed):,} more.")
    if seen.pinned:
        print(f"{_many(seen.pinned, 'job')} with the label `keep` would lose nothing.")


def _row(one: RemovalView) -> tuple[str, ...]:
    loses = "everything" if one.whole else f"{_many(one.files, 'file')} ({', '.join(one.rules)})"
    return (one.job, one.name or "", one.owner or "–", loses, _size(one.bytes))


def _many(number: int, one: str) -> str:
    return f"{number:,} {one}{'' if number == 1 else 's'}"


def _size(size: int) -> str:
    for unit, least in (("TB", 10**12), ("GB", 10**9), ("MB", 10**6), ("kB", 10**3)):
        if size >= least:
            return f"{size / least:.1f} {unit}"
    return f"{size} bytes"


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    table = Table(box=None, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold", justify="right" if column in ("NUMBER", "SIZE") else "left")
    for row in rows:
        table.add_row(*map(Text, row))
    Console().print(table)
