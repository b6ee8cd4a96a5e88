"""`gaitway jobs`, `show`: jobs as they stand; `workers`; `slots`: how many are wanted."""

import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, cast

import typer
from rich.table import Table
from rich.text import Text

from gaitway.battery import shown_battery
from gaitway.cli.common import AsJson, JobName, client_of, job_id, label_of, print_json, wrong_usage
from gaitway.cli.compare import leaves
from gaitway.cli.progress import duration
from gaitway.cli.terminal import Console
from gaitway.frames import RETURNS
from gaitway.schema import AttemptView, JobView

# The metrics that one looks at first.
_MAIN = (
    "eval/episode_reward",
    "eval/forward_speed",
    "eval/avg_episode_length",
    "training/episode_reward",
    "training/forward_speed",
    "training/episode_length",
    "training/fall_rate",
    "training/sps",
)
# The filled-in settings that are shown; `gaitway compare` and the specification have all of them.
_FILLED_IN = ("algorithm.", "physics", "seed")
_STYLES = {"succeeded": "green", "failed": "red", "cancelled": "yellow", "running": "cyan"}


def jobs(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    status: Annotated[str | None, typer.Option()] = None,
    kind: Annotated[str | None, typer.Option(help="train or rollout")] = None,
    environment: Annotated[str | None, typer.Option()] = None,
    name: Annotated[str | None, typer.Option()] = None,
    label: Annotated[
        list[str] | None, typer.Option(metavar="KEY=VALUE", help="Every one must match.")
    ] = None,
    owner: Annotated[str | None, typer.Option(help="A user's name.")] = None,
    project: Annotated[str | None, typer.Option(help="One of yours.")] = None,
    sweep: Annotated[
        str | None, typer.Option(metavar="ID|none|folded", help="Its trials; no trials; one of each sweep.")
    ] = None,
    sort: Annotated[
        str | None, typer.Option(metavar="COLUMN", help="Such as return, duration or label:KEY.")
    ] = None,
    ascending: Annotated[bool, typer.Option("--asc", help="With --sort: the least first.")] = False,
    limit: Annotated[int, typer.Option("--limit", "-n", min=1)] = 20,
    as_json: AsJson = False,
) -> None:
    """List jobs, newest first; with accounts your own before those of others."""
    if ascending and sort is None:
        raise wrong_usage("--asc is the order of --sort: say by which column.")
    labels = dict(map(label_of, label or ()))
    filters = {"status": status, "kind": kind, "environment": environment, "name": name, "labels": labels}
    filters |= {"owner": owner, "project": project, "sweep": sweep}
    order = {"sort": sort, "order": "asc" if ascending else None}
    found = list(client_of(context).list(limit=limit, **filters, **order))
    if as_json:
        print_json(found)
    elif not found:
        print("No jobs." if not any(filters.values()) else "No job matches.")
    else:
        Console().print(_table(found))


def show(
    context: typer.Context,
    job: JobName,
    metrics: Annotated[bool, typer.Option("--metrics", help="All metrics, not only the main ones.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show one job: its settings, progress, attempts and files."""
    client = client_of(context)
    found = client.get(job_id(client, job))
    if as_json:
        print_json(found)
        return
    settings = dict(leaves(found.spec)), dict(leaves(client.specification(found.id)))
    console = Console()
    for line in [
        *_lines(found),
        *_settings(*settings),
        *_metrics(found, all_of_them=metrics),
        *_batteries(found),
        *_parts(found),
    ]:
        console.print(Text(line), soft_wrap=True)


def origin(job: JobView) -> str | None:
    """Where an imported job was run."""
    found = job.imported_from
    if found is None:
        return None
    return f"{found.imported_at:%Y-%m-%d %H:%M}, job {found.job} of a service with Gaitway {found.version}"


def _table(found: Sequence[JobView]) -> Table:
    table = Table(box=None, pad_edge=False)
    owned = any(job.owner for job in found)
    for column in (
        "JOB",
        "KIND",
        "ENVIRONMENT",
        "STATUS",
        "STEPS",
        "RETURN",
        "AGE",
        *["OWNER"] * owned,
        "NAME",
    ):
        table.add_column(column, no_wrap=column == "JOB")
    for job in found:
        age = duration((datetime.now(UTC) - job.created_at).total_seconds())
        share = f"{100 * job.progress.step / job.progress.total:.0f} %" if job.progress.total else ""
        status = Text(_status(job), style=_STYLES.get(job.status, ""))
        owner = [job.owner or ""] * owned
        measured = (job.progress.metrics.get(name) for name in RETURNS)
        last = next((f"{value:.4g}" for value in measured if value is not None), "")
        texts = (job.id, job.kind, job.environment or "", status, share, last, age, *owner, job.name or "")
        table.add_row(*(text if isinstance(text, Text) else Text(text) for text in texts))
    return table


def _status(job: JobView) -> str:
    plain = job.reason in (None, "completed", "user_cancelled")
    return job.status if plain else f"{job.status} ({job.reason})"


def _lines(job: JobView) -> list[str]:
    lines = [f"{job.id}  {job.kind}  {job.environment}  {_status(job)}"]
    facts = {
        "name": job.name,
        "owner": job.owner and f"{job.owner}, in the project {job.project}",
        "labels": ", ".join(f"{name}={value}" for name, value in job.labels.items()),
        "note": (job.note or "").replace("\n", "\n" + 13 * " "),
        "message": job.message,
        "created": _local(job.created_at),
        "started": _local(job.started_at),
        "finished": _local(job.finished_at),
        "again at": _local(job.not_before),
        "waiting": job.waiting_for or (job.turn and job.turn.reason),
        "starts": job.turn and job.turn.starts_at and f"at about {_local(job.turn.starts_at)}, an estimate",
        "imported": origin(job),
        "progress": f"{job.progress.step:,} of {job.progress.total:,} steps" if job.progress.total else "",
        "phase": job.progress.phase,
        "best": _best(job),
    }
    return lines + [f"  {name + ':':<11}{value}" for name, value in facts.items() if value]


def _best(job: JobView) -> str:
    """The best evaluation, of each seed, whose policy is kept."""
    found = [job.newest("best_policy", seed=seed) for seed in job.seeds or [None]]
    return ", ".join(
        f"return {_number(one.metadata.get('return'))} at step {one.step or 0:,} ({one.name})"
        for one in found
        if one is not None
    )


def _batteries(job: JobView) -> list[str]:
    """The verdict on each seed's policy."""
    found = [job.newest("battery", seed=seed) for seed in job.seeds or [None]]
    shown = [(one.name, shown_battery(one.metadata)) for one in found if one is not None]
    return [f"  battery ({name}): {battery.verdict}" for name, battery in shown if battery is not None]


def _number(value: Any) -> str:
    """The number as text; an imported job's metadata may hold anything in its place."""
    return f"{value:g}" if isinstance(value, int | float) else "unknown"


def _local(moment: datetime | None) -> str:
    """In this machine's time zone, to the second."""
    return "" if moment is None else f"{moment.astimezone():%Y-%m-%d %H:%M:%S %Z}"


def _settings(sent: Mapping[str, Any], whole: Mapping[str, Any]) -> list[str]:
    """The settings that were sent, then those that were filled in: one a line, of a list an item a line."""
    left_out = ("kind", "name", "labels", "note", "environment.id")
    shown = {path: value for path, value in sent.items() if not path.startswith(left_out)}
    rest = {path: value for path, value in whole.items() if path not in sent and path.startswith(_FILLED_IN)}
    lines = list[str]()
    for title, found in {"settings": shown, "filled in": rest}.items():
        width = max(map(len, found), default=0)
        lines += [f"  {title}:"] if found else []
        for path, value in found.items():
            first, *more = _items(value)
            lines += [f"    {path:<{width}}  {first}", *(" " * (width + 6) + item for item in more)]
    return lines


def _items(value: Any) -> list[str]:
    """A list of terms as an item a line; anything else as one line."""
    if isinstance(value, list) and any(isinstance(item, dict) for item in cast("list[Any]", value)):
        return [json.dumps(item) for item in cast("list[Any]", value)]
    return [value if isinstance(value, str) else json.dumps(value)]


def _metrics(job: JobView, *, all_of_them: bool) -> list[str]:
    """The main ones first, or alone."""
    found = {name: value for name, value in job.progress.metrics.items() if value is not None}
    main = {name: found.pop(name) for name in _MAIN if name in found}
    if all_of_them:
        main |= dict(sorted(found.items()))
        found = {}
    lines = [f"  {name} = {value:g}" for name, value in main.items()]
    return [*lines, f"  and {len(found)} more metrics: --metrics"] if found else lines


def _parts(job: JobView) -> list[str]:
    """Its attempts and files."""
    lines = list[str]()
    for attempt in job.attempts:
        end = f"{attempt.reason}: {attempt.message}" if attempt.reason else "still running"
        parts = (attempt.worker, _given(attempt), attempt.device, attempt.engine, _allocation(attempt))
        where = ", ".join(part for part in (*parts, *_memory(attempt)) if part)
        lines.append(f"  attempt {attempt.number} on {where}: {end}")
    lines += [f"  {a.name}  {a.size:,} bytes  {a.media_type}" for a in job.artifacts]
    return lines


def _given(attempt: AttemptView) -> str | None:
    """The GPUs that it was given of a pool, if there are several."""
    gpus = str(attempt.details.get("gpus", ""))
    return gpus if "," in gpus else None


def _memory(attempt: AttemptView) -> Iterator[str]:
    """What it had of a GPU's memory."""
    if attempt.gpu_part is not None:
        yield f"with {attempt.gpu_part:.0%} of a GPU's memory"
    if attempt.peak_bytes is not None:
        yield f"{attempt.peak_bytes / 1e9:.2g} GB of memory at most"


def _allocation(attempt: AttemptView) -> str | None:
    """Where a cluster ran it: `Slurm job 4711 on n1, account vnl`."""
    names = attempt.details.get("allocation")
    if not isinstance(names, dict):
        return None
    said = cast("dict[str, Any]", names)
    words = [f"{str(said.get('scheduler', '')).capitalize()} job {said.get('id')}"]
    words += [f"on {said['node']}"] if "node" in said else []
    account = f", account {said['account']}" if "account" in said else ""
    return " ".join(words) + account


def workers(context: typer.Context, as_json: AsJson = False) -> None:
    """List the workers that have sent a heartbeat lately, with what they do."""
    found = list(client_of(context).workers())
    if as_json:
        print_json(found)
        return
    if not found:
        print("No worker is running.")
        return
    table = Table(box=None, pad_edge=False)
    for column in ("WORKER", "DEVICE", "STATE", "JOBS"):
        table.add_column(column, overflow="fold")
    for worker in found:
        state = f"{worker.state}: {worker.problem}" if worker.problem else worker.state
        jobs = worker.jobs or ((worker.job,) if worker.job else ())
        device = worker.device if worker.hosts == 1 else f"{worker.device} of {worker.hosts} hosts"
        device += f" of {worker.pool}" if worker.pool else ""
        table.add_row(*map(Text, (worker.name, device, state, ", ".join(jobs) or "none")))
    Console().print(table)


def slots(context: typer.Context, as_json: AsJson = False) -> None:
    """Show how many jobs wait and run, by what they ask of a worker."""
    found = client_of(context).slots()
    if as_json:
        print_json(found)
        return
    if not found.items:
        print("No job waits or runs.")
        return
    table = Table(box=None, pad_edge=False)
    for column in ("DEVICE", "HOSTS", "QUEUED", "RUNNING", "OLDEST"):
        table.add_column(column)
    for one in found.items:
        device = f"{one.gpus} GPU{'s' if one.gpus > 1 else ''}" if one.gpus else one.accelerator
        age = "" if one.oldest_queued_s is None else duration(one.oldest_queued_s)
        table.add_row(*map(Text, (device, str(one.hosts), str(one.queued), str(one.running), age)))
    Console().print(table)
