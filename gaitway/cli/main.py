"""The terminal program `gaitway`."""

from typing import Annotated

import typer

from gaitway.cli import environments, files, jobs, models, preview, submit, watch
from gaitway.cli.errors import Group
from gaitway.client import Client
from gaitway.service.commands import doctor, importing, recover, services

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
    client = Client(url)
    context.obj = client
    context.call_on_close(client.close)


for command in (
    environments.environments,
    submit.submit,
    jobs.jobs,
    jobs.show,
    watch.watch,
    watch.logs,
    jobs.cancel,
    jobs.delete,
    files.video,
    files.download,
    preview.preview,
    doctor.doctor,
    recover.recover,
    services.up,
):
    app.command()(command)
app.command("import")(importing.import_data)
app.add_typer(models.models, name="models")
for command in (services.demo, services.api, services.worker):
    app.command(context_settings=services.PASS_ON)(command)
