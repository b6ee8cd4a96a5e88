"""`gaitway quotas`: what users and projects may have, and what is used of it."""

from collections.abc import Sequence
from typing import Annotated

import typer
from pydantic import ByteSize, TypeAdapter, ValidationError
from rich.table import Table
from rich.text import Text

from gaitway.cli.common import AsJson, client_of, print_json, size, wrong_usage
from gaitway.cli.terminal import Console
from gaitway.schema import QuotaView

quotas = typer.Typer(help="What users and projects may have.", no_args_is_help=True)
Kind = Annotated[str, typer.Argument(metavar="KIND", help="user or project")]
Name = Annotated[str, typer.Argument(metavar="NAME")]
_SIZE = TypeAdapter(ByteSize)


@quotas.command("list")
def list_quotas(context: typer.Context, as_json: AsJson = False) -> None:
    """List the quotas of yourself and your projects, for an admin all, as USED of LIMIT."""
    found = client_of(context).quotas()
    if as_json:
        print_json(found)
    elif found:
        _print(found)
    else:
        print("No quota is set: everybody may have as much as they like.")


@quotas.command("set")
def set_quota(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    kind: Kind,
    name: Name,
    weight: Annotated[float, typer.Option(help="Of its share where turns are given.")] = 1.0,
    running: Annotated[int | None, typer.Option(help="How many jobs may run at once.")] = None,
    queued: Annotated[int | None, typer.Option(help="How many jobs may wait at once.")] = None,
    gpu_hours: Annotated[float | None, typer.Option(help="In seven days.")] = None,
    stored: Annotated[
        str | None, typer.Option("--bytes", metavar="SIZE", help="Of files and models, such as 200GB.")
    ] = None,
    highest_priority: Annotated[
        str, typer.Option(metavar="low|normal|high", help="Of the jobs that they submit.")
    ] = "high",
    as_json: AsJson = False,
) -> None:
    """Set the whole quota of a user or a project, for an admin: what you leave out has no limit."""
    if kind not in ("user", "project"):
        raise wrong_usage(f"A quota is of a `user` or a `project`, not of a {kind!r}.")
    made = client_of(context).set_quota(
        kind,
        name,
        weight=weight,
        running=running,
        queued=queued,
        gpu_hours=gpu_hours,
        bytes=_bytes(stored),
        highest_priority=highest_priority,
    )
    if as_json:
        print_json(made)
    else:
        _print([made])


@quotas.command("remove")
def remove(context: typer.Context, kind: Kind, name: Name) -> None:
    """Let a user or a project have as much as they like, for an admin."""
    client_of(context).remove_quota(kind, name)
    print(f"The {kind} {name} has no quota any more.")


def _bytes(text: str | None) -> int | None:
    try:
        return None if text is None else int(_SIZE.validate_python(text))
    except ValidationError:
        raise wrong_usage(f"--bytes {text}: write a size such as 200GB, 500MiB or 0.") from None


def _print(found: Sequence[QuotaView]) -> None:
    table = Table(box=None, pad_edge=False)
    for column in ("KIND", "NAME"):
        table.add_column(column, overflow="fold")
    for column in ("WEIGHT", "RUNNING", "QUEUED", "GPU HOURS", "BYTES"):
        table.add_column(column, justify="right")
    table.add_column("PRIORITY")
    for one in found:
        table.add_row(*map(Text, _row(one)))
    Console().print(table)


def _row(one: QuotaView) -> tuple[str, ...]:
    used = one.used
    return (
        one.kind,
        one.name,
        f"{one.weight:g}",
        _of(f"{used.running:,}", None if one.running is None else f"{one.running:,}"),
        _of(f"{used.queued:,}", None if one.queued is None else f"{one.queued:,}"),
        _of(f"{used.gpu_hours:,.1f}", None if one.gpu_hours is None else f"{one.gpu_hours:,g}"),
        _of(size(used.bytes), None if one.bytes is None else size(one.bytes)),
        one.highest_priority,
    )


def _of(used: str, most: str | None) -> str:
    return used if most is None else f"{used} of {most}"
