"""`gaitway doctor`: whether this machine can do what the service needs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from gaitway.cli.common import AsJson, print_json
from gaitway.cli.terminal import Console
from gaitway.service.doctor.check import Check
from gaitway.service.installed import data_folder, use_code

_STYLES = {"pass": "green", "warn": "yellow", "fail": "bold red", "skip": "dim"}


def doctor(
    data: Annotated[
        Path, typer.Option(default_factory=data_folder, help="The service's data folder.", show_default=False)
    ],
    embedded: Annotated[
        bool, typer.Option("--embedded", help="Start the embedded servers briefly and check them.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Check whether this machine can do what the service needs. Exit code 1 if something fails."""
    use_code()
    from gaitway.service.doctor.run import examine

    console, checks = Console(), list[Check]()
    for check in examine(data, embedded=embedded):
        checks.append(check)
        if not as_json:
            console.print(
                Text(f"{check.state:>4}", _STYLES[check.state]), Text(f"{check.name}: {check.detail}")
            )
            if check.remedy:
                console.print(Text(f"       → {check.remedy}"), soft_wrap=True)
    failed = [check for check in checks if check.state == "fail"]
    if as_json:
        print_json({"ok": not failed, "checks": [check.document() for check in checks]})
    else:
        console.print(Text(_closing(failed), "bold red" if failed else "green"), soft_wrap=True)
    raise typer.Exit(1 if failed else 0)


def _closing(failed: Sequence[Check]) -> str:
    if not failed:
        return "Nothing that the service needs is missing."
    return f"{len(failed)} of the checks failed: {', '.join(check.name for check in failed)}."
