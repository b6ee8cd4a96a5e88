"""`gaitway webhooks`: who is told of a project's jobs."""

import time
from collections.abc import Sequence
from datetime import datetime
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from gaitway.cli.common import (
    AsJson,
    Project,
    Yes,
    client_of,
    complain,
    confirm,
    job_id,
    print_json,
    project_of,
    wrong_usage,
)
from gaitway.cli.terminal import Console
from gaitway.schema import DeliveryView, WebhookView

webhooks = typer.Typer(help="Who is told when a job starts or ends.", no_args_is_help=True)
Name = Annotated[str, typer.Argument(metavar="NAME")]
_TEST_S = 30.0
_COLUMNS = ("NAME", "ADDRESS", "EVENTS", "JOBS", "OWNER", "STOPPED")


@webhooks.command("add")
def add(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    name: Name,
    url: Annotated[str, typer.Argument(help="https://…, or an Apprise address such as slack://…")],
    project: Project = None,
    event: Annotated[
        list[str] | None,
        typer.Option(
            help="job.started, job.succeeded, job.failed, job.cancelled, job.attempt_lost, sweep.succeeded, "
            "sweep.failed or sweep.cancelled; repeatable, by default all ends."
        ),
    ] = None,
    jobs: Annotated[str, typer.Option(help="all, own, or named: those sent with --notify NAME.")] = "all",
    as_json: AsJson = False,
) -> None:
    """Tell somebody of jobs. The secret that signs the messages is printed once, on stdout."""
    client = client_of(context)
    whose = project_of(client, project)
    made = client.add_webhook(name, url, project=whose, events=event, jobs=jobs)
    if as_json:
        print_json(made)
        return
    test = f"gaitway webhooks test {name} --project {whose}"
    complain(f"{name} is told of {', '.join(made.events)}. Try it: {test}")
    if made.secret is not None:
        complain("This secret signs its messages. It is shown this once:")
        print(made.secret)


@webhooks.command("list")
def list_webhooks(context: typer.Context, project: Project = None, as_json: AsJson = False) -> None:
    """List a project's webhooks, without their secrets."""
    client = client_of(context)
    found = client.webhooks(project_of(client, project))
    if as_json:
        print_json(found)
        return
    _print(_COLUMNS, [_row(one) for one in found])


@webhooks.command("change")
def change(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    name: Name,
    project: Project = None,
    url: Annotated[str | None, typer.Option(help="Another address; what waits goes there, too.")] = None,
    event: Annotated[list[str] | None, typer.Option(help="In place of its events; repeatable.")] = None,
    jobs: Annotated[str | None, typer.Option(help="all, own, or named.")] = None,
    active: Annotated[
        bool | None,
        typer.Option("--start/--stop", help="Tell it nothing for now, which ends what waits; or again."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Change a webhook's address, events or jobs, stop it, or start it again."""
    client = client_of(context)
    if url is None and not event and jobs is None and active is None:
        raise wrong_usage("Say what changes: --url, --event, --jobs, --stop or --start.")
    inside = project_of(client, project)
    changed = client.change_webhook(
        name, project=inside, url=url, events=event or None, jobs=jobs, active=active
    )
    if as_json:
        print_json(changed)
        return
    _print(_COLUMNS, [_row(changed)])


@webhooks.command("rotate")
def rotate(context: typer.Context, name: Name, project: Project = None, as_json: AsJson = False) -> None:
    """Sign by a new secret, which is printed once, on stdout; the old one signs beside it for a day."""
    client = client_of(context)
    made = client.rotate_secret(name, project=project_of(client, project))
    if as_json:
        print_json(made)
        return
    complain(f"The old secret of {name} signs beside this one until {_moment(made.old_secret_until)}.")
    print(made.secret)


@webhooks.command("delete")
def delete(context: typer.Context, name: Name, project: Project = None, yes: Yes = False) -> None:
    """Send nothing more to a webhook, and forget what was sent."""
    client = client_of(context)
    inside = project_of(client, project)
    confirm(f"Delete the webhook {name} of the project {inside}?", yes=yes)
    client.delete_webhook(name, project=inside)
    print(f"The webhook {name} is deleted.")


@webhooks.command("test")
def send_test(context: typer.Context, name: Name, project: Project = None) -> None:
    """Send a test to a webhook, and say what came of it."""
    client = client_of(context)
    inside = project_of(client, project)
    sent, until = client.test_webhook(name, project=inside), time.monotonic() + _TEST_S
    while not (sent.error or sent.ended_at) and time.monotonic() < until:
        time.sleep(0.3)
        newest = client.deliveries(name, project=inside, limit=20)
        sent = next((one for one in newest if one.id == sent.id), sent)
    print(f"{sent.message}: {_outcome(sent)}")
    if sent.status != "delivered":
        raise typer.Exit(1)


@webhooks.command("resend")
def resend(
    context: typer.Context,
    delivery: Annotated[int, typer.Argument(metavar="ID", help="As `gaitway webhooks deliveries` shows it.")],
    as_json: AsJson = False,
) -> None:
    """Send a message again, as a new delivery; the old one ends if it waits."""
    sent = client_of(context).resend(delivery)
    if as_json:
        print_json(sent)
        return
    print(f"{sent.event} goes to {sent.webhook} again, as delivery {sent.id}.")


@webhooks.command("deliveries")
def deliveries(
    context: typer.Context,
    name: Annotated[str | None, typer.Argument(metavar="[NAME]")] = None,
    project: Project = None,
    job: Annotated[str | None, typer.Option(help="What was sent about this job, in place of NAME.")] = None,
    limit: Annotated[int, typer.Option("--limit", "-n", min=1)] = 20,
    as_json: AsJson = False,
) -> None:
    """Show what was sent in the last week and what came of it, the newest first."""
    client = client_of(context)
    if (name is None) == (job is None):
        raise wrong_usage("Name a webhook, or a job by --job.")
    if job is not None:
        found = client.job_deliveries(job_id(client, job))[:limit]
    else:
        found = list(client.deliveries(str(name), project=project_of(client, project), limit=limit))
    if as_json:
        print_json(found)
        return
    rows = [
        (
            str(one.id),
            _moment(one.created_at),
            one.webhook,
            one.event,
            one.job or "",
            str(one.attempts),
            _outcome(one),
        )
        for one in found
    ]
    _print(("ID", "WHEN", "WEBHOOK", "EVENT", "JOB", "TRIES", "OUTCOME"), rows)


def _row(one: WebhookView) -> Sequence[str]:
    return one.name, one.url, ", ".join(one.events), one.jobs, one.owner or "-", one.stopped or ""


def _outcome(delivery: DeliveryView) -> str:
    if delivery.status == "delivered":
        return f"delivered ({delivery.answer})" if delivery.answer else "delivered"
    then = f" Next try {_moment(delivery.next_attempt_at)}." if delivery.next_attempt_at else ""
    why = delivery.error or "not tried yet."
    return f"{delivery.status}: {why}{then}"


def _moment(moment: datetime | None) -> str:
    return f"{moment.astimezone():%Y-%m-%d %H:%M:%S}" if moment else ""


def _print(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    table = Table(box=None, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*map(Text, row))
    Console().print(table)
