"""`gaitway watch` and `gaitway logs`: follow a job."""

import sys
import webbrowser
from typing import Annotated

import typer
from rich.text import Text

from gaitway.cli.common import AsJson, JobName, client_of, end_code, job_id, print_json
from gaitway.cli.progress import JobProgress
from gaitway.cli.terminal import Console, escaped
from gaitway.client import Client
from gaitway.schema import JobView


def watch_job(client: Client, job: JobView, console: Console) -> JobView:
    """Show the job until it ends, and return it as it then is; Ctrl-C ends only the display."""
    console.print(Text(f"Job {job.id}: {job.kind} {job.environment}"), soft_wrap=True)
    console.print(Text(f"Its page: {page_of(client, job.id)}"), soft_wrap=True)
    try:
        with JobProgress(console) as progress:
            progress.update(job)
            print_what_it_waits_for(client, job, console)
            for event in client.events(job.id):
                progress.update(event)
            job = client.get(job.id)
            progress.update(job)
    except KeyboardInterrupt:
        again = (
            f"The job continues; `gaitway watch {job.id}` shows it again, `gaitway cancel {job.id}` ends it."
        )
        console.print(Text(again), soft_wrap=True)
        raise typer.Exit(130) from None
    console.print(Text(ending(job)), soft_wrap=True)
    return job


def print_what_it_waits_for(client: Client, job: JobView, console: Console) -> None:
    """Print one line if no present worker could run the job."""
    if job.status == "queued" and (lacks := client.get(job.id).waiting_for):
        console.print(Text(lacks, style="yellow"), soft_wrap=True)


def page_of(client: Client, job_id: str) -> str:
    """The address of a job's page."""
    return f"{client.base_url}/#/jobs/{job_id}"


def open_page(address: str) -> None:
    """Open it in the user's browser, or print it where there is none."""
    if not webbrowser.open(address):
        print(f"There is no browser here; the page is {address}", file=sys.stderr)


def ending(job: JobView) -> str:
    """One line on how a job ended."""
    why = f" ({job.reason})" if job.reason and job.reason != "completed" else ""
    return f"Job {job.id} {job.status}{why}{': ' + job.message if job.message else ''}"


def watch(
    context: typer.Context,
    job: JobName,
    in_browser: Annotated[
        bool, typer.Option("--open", help="Open the job's page in a browser, too.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Follow a job live; Ctrl-C stops only the display, not the job. Exit code 1 if the job failed."""
    client = client_of(context)
    found = client.get(job_id(client, job))
    if in_browser:
        open_page(f"{page_of(client, found.id)}/replay")
    if as_json:
        for event in client.events(found.id):
            print(escaped(event.model_dump_json()), flush=True)
        found = client.get(found.id)
    else:
        found = watch_job(client, found, Console())
    raise typer.Exit(end_code(found))


def open_job(
    context: typer.Context,
    job: Annotated[
        str | None, typer.Argument(metavar="JOB", help="As elsewhere; without it, the page of all jobs.")
    ] = None,
) -> None:
    """Open the page of a job, or of the service, in a browser."""
    client = client_of(context)
    open_page(f"{client.base_url}/" if job is None else page_of(client, job_id(client, job)))


def logs(
    context: typer.Context,
    job: JobName,
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Continue until the job ends.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print a job's log."""
    client = client_of(context)
    lines = client.logs(job_id(client, job), follow=follow)
    if as_json:
        print_json(list(lines))
        return
    try:
        for line in lines:
            print(line, flush=follow)
    except KeyboardInterrupt:
        raise typer.Exit(130) from None
