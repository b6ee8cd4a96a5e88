"""The commands of the service itself, which are part of the CLI; the extra `up` brings what they need."""

import importlib.util

import typer

from gaitway.service.commands import add_to


def add_commands(app: typer.Typer) -> None:
    """Add them; hidden where what every part of the service needs is missing: they say how to install it."""
    add_to(app, hidden=importlib.util.find_spec("rq") is None)
