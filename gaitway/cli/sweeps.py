"""`gaitway sweep`: start one; `gaitway sweeps`: list, show, change, cancel, resume, delete."""

import time
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from itertools import islice
from typing import Annotated

import typer
from rich.console import Group as Lines
from rich.console import RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from gaitway.cli.changes import NewLabels, NewName, NewNote, WithoutLabels, changes_of
from gaitway.cli.common import AsJson, CommandGroup, Yes, client_of, confirm, full_id, print_json
from gaitway.cli.progress import duration
from gaitway.cli.submit import read
from gaitway.cli.terminal import Console
from gaitway.client import Client
from gaitway.schema import SweepDetails, TrialView

sweeps = typer.Typer(cls=CommandGroup, help="See sweeps and what came of them.", invoke_without_command=True)

SweepName = Annotated[str, typer.Argument(metavar="SWEEP", help="A sweep's id, its end, or `last`.")]
_STYLES = {"succeeded": "green", "failed": "red", "running": "cyan"}
_EVERY_S = 1.0
_MOST_REASONS = 3


def sweep(
    context: typer.Context,
    file: Annotated[str, typer.Argument(help="JSON of a sweep; `-` reads stdin.")],
    watch: Annotated[bool, typer.Option("--watch", "-w", help="Stay and show the trials.")] = False,
    as_json: AsJson = False,
) -> None:
    """Start a sweep: jobs whose settings vary. Exit code 1 if it is watched and fails."""
    client = client_of(context)
    started = client.sweep(read(file))
    if watch:
        started = _watched(client, started, Console(stderr=as_json))
    if as_json:
        print_json(started)
    elif not watch:
        print(started.id)
    raise typer.Exit(1 if watch and started.status != "succeeded" else 0)


@sweeps.callback()
def overview(
    context: typer.Context,
    status: Annotated[str | None, typer.Option()] = None,
    limit: Annotated[int, typer.Option("--limit", "-n", min=1)] = 20,
    as_json: AsJson = False,
) -> None:
    """List sweeps, newest first."""
    if context.invoked_subcommand is not None:
        return
    found = list(client_of(context).sweeps(limit=limit, status=status))
    if as_json:
        print_json(found)
    elif not found:
        print("No sweeps." if status is None else "No sweep matches.")
    else:
        Console().print(_list(found))


@sweeps.command()
def show(
    context: typer.Context,
    sweep: SweepName,
    watch: Annotated[bool, typer.Option("--watch", "-w", help="Stay until it ends.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show one sweep: its trials by their objective, the best first."""
    client = client_of(context)
    found = client.get_sweep(_id(client, sweep))
    if watch:
        found = _watched(client, found, Console(stderr=as_json))
    if as_json:
        print_json(found)
    elif not watch:
        Console().print(_state(found))


@sweeps.command()
def change(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    sweep: SweepName,
    name: NewName = None,
    label: NewLabels = None,
    without_label: WithoutLabels = None,
    note: NewNote = None,
    as_json: AsJson = False,
) -> None:
    """Rename a sweep, change its labels, or note something about it; its next trials get the labels."""
    changes = changes_of(name, label, without_label, note)
    client = client_of(context)
    found = client.change_sweep(_id(client, sweep), **changes)
    if as_json:
        print_json(found)
    else:
        print(f"Sweep {found.id} is changed.")


@sweeps.command()
def cancel(context: typer.Context, sweep: SweepName, as_json: AsJson = False) -> None:
    """Cancel a sweep and its trials, which keep their work."""
    client = client_of(context)
    _told(client.cancel_sweep(_id(client, sweep)), as_json)


@sweeps.command()
def resume(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    sweep: SweepName,
    jobs: Annotated[int | None, typer.Option(min=1, help="Trials in all, with those so far.")] = None,
    parallel: Annotated[int | None, typer.Option(min=1, help="Trials at the same time.")] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Environment steps in all.")] = None,
    gpu_hours: Annotated[float | None, typer.Option(help="Hours of GPUs in all.")] = None,
    as_json: AsJson = False,
) -> None:
    """Continue a sweep under another budget."""
    bounds = {"jobs": jobs, "parallel": parallel, "steps": steps, "gpu_hours": gpu_hours}
    client = client_of(context)
    budget = {name: value for name, value in bounds.items() if value is not None}
    _told(client.resume_sweep(_id(client, sweep), **budget), as_json)


@sweeps.command()
def delete(context: typer.Context, sweep: SweepName, yes: Yes = False) -> None:
    """Delete the record of an ended sweep; its jobs stay."""
    client = client_of(context)
    full_id = _id(client, sweep)
    confirm(f"Delete the record of sweep {full_id}?", yes=yes)
    client.delete_sweep(full_id)
    print(f"Sweep {full_id} is deleted; its jobs stay.")


def _id(client: Client, name: str) -> str:
    return full_id(name, lambda limit: client.sweeps(limit=limit), "sweep")


def _told(sweep: SweepDetails, as_json: bool) -> None:
    if as_json:
        print_json(sweep)
    else:
        print(f"Sweep {sweep.id} is {sweep.status}.")


def _watched(client: Client, sweep: SweepDetails, console: Console) -> SweepDetails:
    """Show the sweep until it ends, and return it as it then is; Ctrl-C ends only the display."""
    try:
        if not console.is_terminal:
            return _told_of_changes(client, sweep, console)
        with Live(_state(sweep), console=console, auto_refresh=False) as live:
            while not sweep.is_final:
                time.sleep(_EVERY_S)
                sweep = client.get_sweep(sweep.id)
                live.update(_state(sweep), refresh=True)
    except KeyboardInterrupt:
        console.print(f"The sweep continues; `gaitway sweeps show {sweep.id} --watch` shows it again.")
        raise typer.Exit(130) from None
    return sweep


def _told_of_changes(client: Client, sweep: SweepDetails, console: Console) -> SweepDetails:
    """A line for each change, and all trials at the end."""
    told = set[str]()
    while True:
        for line in _news(sweep):
            if line not in told:
                told.add(line)
                console.print(Text(line), soft_wrap=True)
        if sweep.is_final:
            console.print(_state(sweep))
            return sweep
        time.sleep(_EVERY_S)
        sweep = client.get_sweep(sweep.id)


def _news(sweep: SweepDetails) -> Iterable[str]:
    """A line for its status, and one for each trial's."""
    yield f"Sweep {sweep.id} {sweep.status}"
    for trial in sweep.trials:
        axes = ", ".join(
            f"{name.rpartition('.')[2]}={_number(one)}" for name, one in trial.parameters.items()
        )
        ended = trial.status not in ("queued", "starting", "running")
        values = f": {_values(trial)}" if ended and trial.values else ""
        yield f"trial {trial.number} {trial.status} ({axes}){values}"


def _list(found: Iterable[SweepDetails]) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in ("SWEEP", "METHOD", "STATUS", "TRIALS", "BEST", "AGE", "NAME"):
        table.add_column(column, no_wrap=column == "SWEEP")
    for sweep in found:
        age = duration((datetime.now(UTC) - sweep.created_at).total_seconds())
        trials = f"{sum(sweep.num_trials.values())} of {sweep.max_trials}"
        best = _values(sweep.best[0]) if sweep.best else ""
        status = Text(sweep.status, style=_STYLES.get(sweep.status, ""))
        method = Text(sweep.spec.get("method", ""))
        table.add_row(sweep.id, method, status, trials, best, age, Text(sweep.name or ""))
    return table


def _state(sweep: SweepDetails) -> RenderableType:
    """All there is to see of one sweep."""
    counted = ", ".join(f"{number} {status}" for status, number in sweep.num_trials.items())
    lines = [f"Sweep {sweep.id} {sweep.status}: {counted or 'no trial yet'}, of {sweep.max_trials} at most"]
    lines += [one for one in (sweep.name, sweep.note, sweep.message) if one]
    lines += [
        f"importance for {metric}: " + ", ".join(f"{axis} {share:.0%}" for axis, share in _by_share(shares))
        for metric, shares in (sweep.importance or {}).items()
    ]
    lines += islice(_reasons(sweep), _MOST_REASONS)
    return Lines(*(Text(line) for line in lines), _trials(sweep))


def _reasons(sweep: SweepDetails) -> Iterator[str]:
    """Why trials have no result; of several that say the same, the first."""
    told = set[str]()
    for trial in sweep.trials:
        if trial.status in ("failed", "refused") and trial.message and trial.message not in told:
            told.add(trial.message)
            yield f"trial {trial.number} {trial.status}: {trial.message}"


def _by_share(shares: Mapping[str, float]) -> list[tuple[str, float]]:
    return sorted(shares.items(), key=lambda pair: -pair[1])


def _trials(sweep: SweepDetails) -> Table:
    table = Table(box=None, pad_edge=False)
    axes = list(sweep.spec.get("parameters", {}))
    metrics = [metric.rpartition("/")[2] for metric in sweep.metrics]
    lineage = ("GEN", "FROM") if sweep.spec.get("population") else ()
    for column in ("TRIAL", *lineage, "STATUS", *metrics, *(axis.rpartition(".")[2] for axis in axes), "JOB"):
        table.add_column(Text(column), no_wrap=column == "JOB")
    best = {trial.number for trial in sweep.best}
    for trial in sorted(sweep.trials, key=lambda trial: _rank(sweep, trial)):
        values = [_number(value) for value in trial.values] or [""] * len(sweep.metrics)
        given = [Text(_number(trial.parameters.get(axis))) for axis in axes]
        status = Text(trial.status, style=_STYLES.get(trial.status, ""))
        style = "bold" if trial.number in best else ""
        born = [_number(trial.generation), _number(trial.parent)] if lineage else []
        table.add_row(str(trial.number), *born, status, *values, *given, trial.job or "", style=style)
    return table


def _rank(sweep: SweepDetails, trial: TrialView) -> tuple[bool, float]:
    """By the first objective, the best first; those without a value last."""
    sign = -1 if sweep.is_minimized else 1
    value = trial.values[0] if trial.values else None
    return (value is None, -sign * (value or 0.0))


def _values(trial: TrialView) -> str:
    return ", ".join(_number(value) for value in trial.values)


def _number(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)
