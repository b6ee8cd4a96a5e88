"""The terminal program `gaitway`."""

from typing import Annotated

import typer

from gaitway.cli import compare, environments, files, jobs, models, preview, service, submit, sweeps, watch
from gaitway.cli.errors import Group

app = typer.Typer(
    cls=Group,
    help="Send training jobs to a Gaitway service, watch them, and fetch what they made.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.callback()
def main(
    context: typer.Context,
    url: Annotated[
        str | None,
        typer.Option(envvar="GAITWAY_URL", help="Address of the service; by default http://127.0.0.1:8000."),
    ] = None,
) -> None:
    """Send training jobs to a Gaitway service, watch them, and fetch what they made."""
    context.obj = url


for command in (
    environments.environments,
    submit.submit,
    jobs.jobs,
    jobs.show,
    watch.watch,
    watch.logs,
    compare.compare,
    jobs.cancel,
    jobs.delete,
    files.video,
    files.export,
    files.share,
    files.download,
    preview.preview,
    sweeps.sweep,
):
    app.command()(command)
app.command("import")(files.import_job)
app.add_typer(models.models, name="models")
app.add_typer(sweeps.sweeps, name="sweeps")
service.add_commands(app)
