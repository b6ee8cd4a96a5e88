"""The commands of the service itself, which are part of the CLI in a clone and in the images."""

import importlib.util

import typer

from gaitway.cli.common import PASS_ON
from gaitway.cli.errors import wrong_usage

_NAMES = ("api", "check", "demo", "doctor", "play", "profile", "run", "up", "worker")


def add_commands(app: typer.Typer) -> None:
    """Add them; where the service is not installed, hidden commands that say where it is."""
    if importlib.util.find_spec("gaitway.service") is not None:
        from gaitway.service.commands import add_to

        add_to(app)
        return
    for name in _NAMES:
        app.command(name, hidden=True, context_settings=PASS_ON)(_refuse)


def _refuse(context: typer.Context) -> None:
    raise wrong_usage(
        f"`gaitway {context.info_name}` is a command of the service, and only the client is installed here. "
        "The service runs from a clone: `git clone https://github.com/gaitway/gaitway`, and there `./run up` "
        "or `docker compose up -d --wait`."
    )
