"""The CLI's commands that start, inspect or repair a service."""

import typer

from gaitway.cli.common import PASS_ON
from gaitway.service.commands import check, cluster, doctor, play, plugins, profile, run, services


def add_to(app: typer.Typer, *, hidden: bool) -> None:
    """Add them to the program. hidden: from its help."""
    for command in (
        check.check,
        doctor.doctor,
        play.play,
        plugins.plugins,
        profile.profile,
        run.run,
        services.up,
    ):
        app.command(hidden=hidden)(command)
    for command in (services.demo, services.api):
        app.command(hidden=hidden, context_settings=PASS_ON)(command)
    app.command(hidden=hidden)(services.worker)
    app.add_typer(cluster.cluster, name="cluster", hidden=hidden)
