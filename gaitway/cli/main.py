"""The terminal program `gaitway`."""

from importlib.metadata import version
from typing import Annotated

import typer

from gaitway.cli import (
    accounts,
    battery,
    changes,
    clips,
    compare,
    environments,
    files,
    jobs,
    models,
    quotas,
    retention,
    service,
    submit,
    sweeps,
    usage,
    watch,
    webhooks,
)
from gaitway.cli.common import CommandGroup

app = typer.Typer(
    cls=CommandGroup,
    help="Send training jobs to a Gaitway service, watch them, and fetch what they made.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _version(asked: bool) -> None:
    if asked:
        print(f"gaitway {version('gaitway')}")
        raise typer.Exit


@app.callback()
def main(
    context: typer.Context,
    url: Annotated[
        str | None,
        typer.Option(
            envvar="GAITWAY_URL",
            help="Address of the service; by default that of `gaitway up`, or port 8000.",
        ),
    ] = None,
    _shown: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version of this client."),
    ] = False,
) -> None:
    """Send training jobs to a Gaitway service, watch them, and fetch what they made."""
    context.obj = url


for command in (
    environments.environments,
    submit.submit,
    submit.rollout,
    jobs.jobs,
    jobs.show,
    watch.watch,
    watch.logs,
    compare.compare,
    battery.battery,
    changes.change,
    changes.cancel,
    changes.delete,
    files.video,
    files.export,
    files.share,
    files.download,
    environments.preview,
    sweeps.sweep,
    jobs.workers,
    jobs.slots,
    accounts.login,
    accounts.logout,
    accounts.whoami,
    accounts.audit,
    usage.usage,
):
    app.command()(command)
app.command("open")(watch.open_job)
app.command("import")(files.import_job)
app.add_typer(accounts.users, name="users")
app.add_typer(accounts.projects, name="projects")
app.add_typer(accounts.tokens, name="tokens")
app.add_typer(retention.retention, name="retention")
app.add_typer(quotas.quotas, name="quotas")
app.add_typer(webhooks.webhooks, name="webhooks")
app.add_typer(models.models, name="models")
app.add_typer(clips.clips, name="clips")
app.add_typer(sweeps.sweeps, name="sweeps")
service.add_commands(app)
