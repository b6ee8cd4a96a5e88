"""`gaitway cluster`: workers on the cluster that a lab already has."""

from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from gaitway.cli.common import complain, wrong_usage
from gaitway.service.commands.services import require
from gaitway.service.installed import data_folder

cluster = typer.Typer(
    help="Keep as many workers on a cluster as the queue wants.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Config = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="A TOML file with all options: docs/clusters.md."),
]
Partition = Annotated[str | None, typer.Option(help="As for sbatch; by default the cluster's default.")]
Account = Annotated[str | None, typer.Option(help="As for sbatch.")]
Qos = Annotated[str | None, typer.Option(help="As for sbatch.")]
Time = Annotated[str | None, typer.Option("--time", help="Time limit of a worker, e.g. 8:00:00.")]
Gpus = Annotated[
    str | None,
    typer.Option(metavar="1,2,…", help="Workers on GPUs, for jobs of these many; without it on CPUs."),
]
Cpus = Annotated[int | None, typer.Option(min=1, help="Cores of a worker; of one on GPUs, for each.")]
Mem = Annotated[str | None, typer.Option(help="Memory of a worker; of one on GPUs, for each. E.g. 32G.")]
TunnelHost = Annotated[
    str | None,
    typer.Option(
        "--tunnel",
        metavar="HOST",
        help="Nodes reach the stores by ssh to it; by default to this machine where the stores listen for it "
        "alone. `none`: without.",
    ),
]

Folder = Annotated[
    Path | None,
    typer.Option(
        help="Where settings and logs of the workers lie; all nodes must see it. By default `cluster` in the "
        "data folder."
    ),
]


def options_said(  # noqa: PLR0913 # A command line's options.
    *,
    partition: str | None,
    account: str | None,
    qos: str | None,
    limit: str | None,
    gpus: str | None,
    cpus: int | None,
    mem: str | None,
    tunnel: str | None,
    has_file: bool,
) -> dict[str, Any]:
    """The command line's options in the form of the file. Raises typer.Exit."""
    named = {
        "partition": partition,
        "account": account,
        "qos": qos,
        "time": limit,
        "cpus": cpus,
        "mem": mem,
    }
    part: dict[str, Any] = {name: value for name, value in named.items() if value is not None}
    said: dict[str, Any] = {}
    if gpus is not None:
        try:
            part["gpus"] = [int(number) for number in gpus.split(",")]
        except ValueError:
            raise wrong_usage(f"--gpus {gpus!r} is not a list of numbers such as 1,2,4.") from None
    if part or not has_file:
        said["gpu" if gpus is not None else "cpu"] = part
    if tunnel is not None:
        said["tunnel"] = "none" if tunnel == "none" else {"host": tunnel}
    return said


@cluster.command()
def slurm(  # noqa: PLR0913 # A command line's options.
    data: Annotated[
        Path,
        typer.Option(
            default_factory=data_folder,
            show_default=False,
            help="The data folder of the `gaitway up` whose jobs they take; unless GAITWAY_… name stores.",
        ),
    ],
    config: Config = None,
    partition: Partition = None,
    account: Account = None,
    qos: Qos = None,
    limit: Time = None,
    gpus: Gpus = None,
    cpus: Cpus = None,
    mem: Mem = None,
    tunnel: TunnelHost = None,
    most: Annotated[int | None, typer.Option("--max", min=1, help="Workers at once; by default 4.")] = None,
    idle: Annotated[
        float | None, typer.Option(help="Seconds after which a worker without a job ends; by default 120.")
    ] = None,
    folder: Folder = None,
    show: Annotated[
        bool, typer.Option("--print", help="Print the batch scripts, and start nothing.")
    ] = False,
    show_template: Annotated[
        bool, typer.Option("--print-template", help="Print our template, and start nothing.")
    ] = False,
) -> None:
    """Keep as many workers on Slurm as the queue wants, until Ctrl-C.

    It runs as you, on a machine that has sbatch: beside `gaitway up`, for example. It may be ended and
    started again at any time.
    """
    require("worker", "rq", "redis", "minio", "psycopg")
    from core.errors import Misconfigured
    from worker.cluster.main import serve, shown
    from worker.cluster.options import read_options
    from worker.cluster.script import TEMPLATE

    if show_template:
        print(TEMPLATE, end="")
        return
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
    said |= {name: value for name, value in (("max", most), ("idle", idle)) if value is not None}
    try:
        options = read_options(config, said)
        place = folder or data / "cluster"
        if show:
            print(shown(options, data, place))
        else:
            serve(options, data, place, _say)
    except Misconfigured as error:
        complain(error.detail)
        raise typer.Exit(2) from None


def _say(sentence: str) -> None:
    print(f"{datetime.now().astimezone():%H:%M:%S}  {sentence}", flush=True)
