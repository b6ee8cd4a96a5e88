"""`gaitway environments`: lists the environments that a job may name."""

from collections import Counter
from typing import Annotated

import typer

from gaitway.cli.common import AsJson, client_of, print_json


def environments(
    context: typer.Context,
    family: Annotated[
        str | None,
        typer.Option(help="`gaitway`, or a package with environments: playground, brax."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the environments that a job may name; --family lists those of another package."""
    found = client_of(context).environments()
    shown = [one for one in found if one.family == (family or "gaitway")]
    if as_json:
        print_json(shown)
        return
    for one in shown:
        print(f"{one.id:<36}  {one.description}")
    if family is None:
        others = Counter(one.family for one in found if one.family != "gaitway")
        for name, number in others.items():
            print(f"and {number} of {name}: --family {name}")
    elif not shown:
        print(f"There are no environments of {family}.")
