"""`gaitway change`: a job's name, labels, note; `cancel`, `delete`: one job, several, or all that match."""

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer

from gaitway.cli.common import (
    AsJson,
    JobName,
    Yes,
    client_of,
    complain,
    confirm,
    job_id,
    label_of,
    print_json,
    wrong_usage,
)
from gaitway.cli.watch import ending
from gaitway.client import Client
from gaitway.schema import OutcomeView

JobNames = Annotated[list[str] | None, typer.Argument(metavar="[JOB]...", help="As for `gaitway show`.")]
Status = Annotated[str | None, typer.Option(help="In place of names: all that match these filters.")]
Kind = Annotated[str | None, typer.Option(help="train or rollout")]
Environment = Annotated[str | None, typer.Option()]
Name = Annotated[str | None, typer.Option(help="The whole name.")]
Labels = Annotated[
    list[str] | None, typer.Option("--label", metavar="KEY=VALUE", help="Every one must match.")
]
Owner = Annotated[str | None, typer.Option(help="A user's name.")]
Project = Annotated[str | None, typer.Option(help="One of yours.")]


NewName = Annotated[str | None, typer.Option("--name", help='"" takes it away.')]
NewLabels = Annotated[list[str] | None, typer.Option("--label", metavar="KEY=VALUE", help="Repeatable.")]
WithoutLabels = Annotated[
    list[str] | None, typer.Option("--without-label", metavar="KEY", help="Repeatable.")
]
NewNote = Annotated[str | None, typer.Option("--note", help='"" takes it away; `-` reads stdin.')]


def change(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    job: JobName,
    name: NewName = None,
    label: NewLabels = None,
    without_label: WithoutLabels = None,
    note: NewNote = None,
    as_json: AsJson = False,
) -> None:
    """Rename a job, change its labels, or note something about it, also while it runs."""
    changes = changes_of(name, label, without_label, note)
    client = client_of(context)
    found = client.change(job_id(client, job), **changes)
    if as_json:
        print_json(found)
    else:
        print(f"Job {found.id} is changed.")


def changes_of(
    name: str | None, label: Sequence[str] | None, without_label: Sequence[str] | None, note: str | None
) -> Mapping[str, Any]:
    """The fields that change, None for one that is taken away. Raises typer.Exit(2) where there is none."""
    labels = dict[str, str | None](map(label_of, label or ())) | dict.fromkeys(without_label or ())
    text = sys.stdin.read() if note == "-" else note
    given = {"name": name, "labels": labels or None, "note": text}
    changes = {what: value or None for what, value in given.items() if value is not None}
    if not changes:
        raise wrong_usage("Nothing changes: give --name, --label, --without-label or --note.")
    return changes


def cancel(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    jobs: JobNames = None,
    status: Status = None,
    kind: Kind = None,
    environment: Environment = None,
    name: Name = None,
    label: Labels = None,
    owner: Owner = None,
    project: Project = None,
    yes: Yes = False,
    as_json: AsJson = False,
) -> None:
    """Stop jobs; their checkpoints, metrics and videos up to now are kept."""
    client = client_of(context)
    filters = _given(label, status=status, kind=kind, environment=environment, name=name)
    filters |= _given(None, owner=owner, project=project)
    if jobs and len(jobs) == 1 and not filters:
        found = client.cancel(job_id(client, jobs[0]))
        if as_json:
            print_json(found)
        else:
            print(ending(found) if found.is_final else f"Job {found.id} is {found.status}.")
        return
    ids = _ids(client, jobs or (), filters, have_ended=False)
    if filters and ids:
        confirm(f"Cancel {_number(len(ids))}?", yes=yes)
    _tell(client.cancel_all(ids), as_json=as_json)


def delete(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    jobs: JobNames = None,
    status: Status = None,
    kind: Kind = None,
    environment: Environment = None,
    name: Name = None,
    label: Labels = None,
    owner: Owner = None,
    project: Project = None,
    yes: Yes = False,
    as_json: AsJson = False,
) -> None:
    """Delete ended jobs and their files permanently."""
    client = client_of(context)
    filters = _given(label, status=status, kind=kind, environment=environment, name=name)
    filters |= _given(None, owner=owner, project=project)
    ids = _ids(client, jobs or (), filters, have_ended=True)
    if len(ids) == 1:
        found = client.get(ids[0])
        about = " ".join(part for part in (found.kind, found.environment, found.name, found.status) if part)
        confirm(f"Delete job {found.id} ({about}) and its {len(found.artifacts)} files?", yes=yes)
        client.delete(found.id)
        _tell([OutcomeView(job=found.id, result="deleted")], as_json=as_json)
        return
    if ids:
        confirm(f"Delete {_number(len(ids))} and their files?", yes=yes)
    _tell(client.delete_all(ids), as_json=as_json)


def _given(labels: Sequence[str] | None, **filters: str | None) -> dict[str, Any]:
    given: dict[str, Any] = {name: value for name, value in filters.items() if value is not None}
    return given | ({"labels": dict(map(label_of, labels))} if labels else {})


def _ids(
    client: Client, names: Sequence[str], filters: Mapping[str, Any], *, have_ended: bool
) -> Sequence[str]:
    """The named jobs; or those that match and have ended, or not. Raises typer.Exit(2)."""
    if bool(names) == bool(filters):
        raise wrong_usage("Name the jobs, or say which by --status, --label and so on; not both.")
    if names:
        return list(dict.fromkeys(job_id(client, name) for name in names))
    found = list(client.list(**filters))
    ids = [job.id for job in found if job.is_final == have_ended]
    if others := len(found) - len(ids):
        which = f"which {'has' if others == 1 else 'have'} {'not ' * have_ended}ended"
        complain(f"Left out: {_number(others)}, {which}.")
    return ids


def _tell(outcomes: Sequence[OutcomeView], *, as_json: bool) -> None:
    """Say what became of them. Raises typer.Exit(1) where one was refused."""
    refused = [one for one in outcomes if one.result == "refused"]
    if as_json:
        print_json(list(outcomes))
    elif not outcomes:
        print("No job matches.")
    else:
        for one in refused:
            complain(one.message or f"Job {one.job} is refused.")
        for result, number in Counter(one.result for one in outcomes).items():
            if len(outcomes) == 1 and not refused:
                print(f"Job {outcomes[0].job} is {result}.")
            else:
                print(f"{_number(number)} {'is' if number == 1 else 'are'} {result}.")
    if refused:
        raise typer.Exit(1)


def _number(jobs: int) -> str:
    return "1 job" if jobs == 1 else f"{jobs:,} jobs"
