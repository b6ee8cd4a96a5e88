"""`gaitway doctor`: whether this machine can do what the service needs."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

from gaitway.cli.common import AsJson, print_json
from gaitway.cli.terminal import Console
from gaitway.service.commands.cluster import (
    Account,
    Config,
    Cpus,
    Folder,
    Gpus,
    Mem,
    Partition,
    Qos,
    Time,
    TunnelHost,
    options_said,
)
from gaitway.service.commands.services import require
from gaitway.service.doctor.check import Check
from gaitway.service.installed import data_folder, use_code

_STYLES = {"pass": "green", "warn": "yellow", "fail": "bold red", "skip": "dim"}


def doctor(  # noqa: PLR0913 # A command line's options.
    data: Annotated[
        Path, typer.Option(default_factory=data_folder, help="The service's data folder.", show_default=False)
    ],
    embedded: Annotated[
        bool, typer.Option("--embedded", help="Start the embedded servers briefly and check them.")
    ] = False,
    slurm: Annotated[
        bool,
        typer.Option(
            "--slurm", help="Check instead, on a login node, whether `gaitway cluster slurm` could work."
        ),
    ] = False,
    on_node: Annotated[
        bool, typer.Option("--node", help="With --slurm: run a short job on a node, too.")
    ] = False,
    config: Config = None,
    partition: Partition = None,
    account: Account = None,
    qos: Qos = None,
    limit: Time = None,
    gpus: Gpus = None,
    cpus: Cpus = None,
    mem: Mem = None,
    tunnel: TunnelHost = None,
    folder: Folder = None,
    as_json: AsJson = False,
) -> None:
    """Check whether this machine can do what the service needs. Exit code 1 if something fails.

    The options from --config to --folder are for --slurm, and those of `gaitway cluster slurm`.
    """
    use_code()
    said = options_said(
        partition=partition,
        account=account,
        qos=qos,
        limit=limit,
        gpus=gpus,
        cpus=cpus,
        mem=mem,
        tunnel=tunnel,
        has_file=config is not None,
    )
    console, checks = Console(), list[Check]()
    if slurm:
        require("worker", "rq", "redis", "minio", "psycopg")
        found = _of_slurm(config, said, data, folder or data / "cluster", on_node)
    else:
        from gaitway.service.doctor.run import examine

        found = examine(data, embedded=embedded)
    for check in found:
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


def _of_slurm(
    config: Path | None, said: dict[str, Any], data: Path, folder: Path, on_node: bool
) -> Iterator[Check]:
    from core.errors import Misconfigured
    from gaitway.service.doctor.slurm import examine_slurm
    from worker.cluster.options import read_options

    try:
        options = read_options(config, said)
    except Misconfigured as error:
        return iter([Check("options", "fail", error.detail, "docs/clusters.md has an example of all.")])
    return examine_slurm(options, data, folder, on_node=on_node)


def _closing(failed: Sequence[Check]) -> str:
    if not failed:
        return "Nothing that the service needs is missing."
    return f"{len(failed)} of the checks failed: {', '.join(check.name for check in failed)}."
