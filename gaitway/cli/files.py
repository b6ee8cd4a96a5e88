"""`gaitway video`, `export`, `share`, `download`, `import`: fetch the files of a job, or move all of it."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.progress import BarColumn, DownloadColumn, Progress, TransferSpeedColumn

from gaitway.addresses import OnBytes
from gaitway.cli.common import AsJson, JobName, client_of, job_id, print_json, wrong_usage
from gaitway.cli.jobs import origin
from gaitway.cli.terminal import Console

Output = Annotated[
    Path | None, typer.Option("--output", "-o", help="A file or a folder; by default the current one.")
]

OfSeed = Annotated[
    int | None, typer.Option("--seed", help="Whose, of a job with several seeds; by default the first's.")
]


def video(
    context: typer.Context,
    job: JobName,
    output: Output = None,
    step: Annotated[int | None, typer.Option(help="The video of the checkpoint with this step.")] = None,
    seed: OfSeed = None,
    as_json: AsJson = False,
) -> None:
    """Fetch a job's video as an MP4."""
    client = client_of(context)
    full_id = job_id(client, job)
    suffix = ("" if step is None else f"-{step}") + ("" if seed is None else f"-seed-{seed}")
    target = output or Path(f"{full_id}{suffix}.mp4")
    _told(
        _with_bar(lambda on_bytes: client.video(full_id, target, step, seed=seed, on_bytes=on_bytes)), as_json
    )


def export(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    job: JobName,
    format: Annotated[
        Literal["onnx", "numpy", "robot", "zip"],
        typer.Option(
            help="onnx, numpy: the policy for any ONNX runtime, or for NumPy alone (docs/export.md). robot: "
            "ONNX from what a robot measures to its joints' targets. "
            "zip: all that is needed to run the job again elsewhere (docs/sharing.md)."
        ),
    ] = "onnx",
    best: Annotated[
        bool, typer.Option("--best", help="The policy of the best evaluation, not the last one.")
    ] = False,
    seed: OfSeed = None,
    output: Output = None,
    as_json: AsJson = False,
) -> None:
    """Fetch a trained policy for programs without Gaitway and JAX, or the whole job as a zip."""
    client = client_of(context)
    full_id = job_id(client, job)
    if format == "zip":
        if best or seed is not None:
            raise wrong_usage("A zip has all of the job's policies: leave out --best and --seed.")
        _told(client.export(full_id, output), as_json)
        return
    _told(
        _with_bar(
            lambda on_bytes: client.export_policy(
                full_id, format, output, best=best, seed=seed, on_bytes=on_bytes
            )
        ),
        as_json,
    )


def share(context: typer.Context, job: JobName, output: Output = None, as_json: AsJson = False) -> None:
    """Fetch a report on a job to send to others: one HTML file with curves and video."""
    client = client_of(context)
    _told(client.share(job_id(client, job), output), as_json)


def download(
    context: typer.Context,
    job: JobName,
    name: Annotated[str, typer.Argument(help="As `gaitway show` lists it.")],
    output: Output = None,
    as_json: AsJson = False,
) -> None:
    """Fetch one of a job's files; an interrupted download resumes where it stopped."""
    client = client_of(context)
    full_id = job_id(client, job)
    _told(_with_bar(lambda on_bytes: client.download(full_id, name, output, on_bytes=on_bytes)), as_json)


def import_job(
    context: typer.Context,
    file: Annotated[
        Path,
        typer.Argument(exists=True, dir_okay=False, help="As `gaitway export JOB --format zip` made it."),
    ],
    project: Annotated[
        str | None, typer.Option(help="Whose members see it; needless with one project of your own.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Make an ended job of an export, to resume from and to roll out; its model is sent, too."""
    job = client_of(context).import_job(file, project=project)
    if as_json:
        print_json(job)
        return
    print(job.id)
    print(f"{job.status}; {origin(job)}", file=sys.stderr)


def _with_bar(fetch: Callable[[OnBytes], Path]) -> Path:
    with Progress(
        BarColumn(), DownloadColumn(), TransferSpeedColumn(), console=Console(stderr=True), transient=True
    ) as bar:
        task = bar.add_task("", total=None)
        return fetch(lambda here, in_all: bar.update(task, completed=here, total=in_all))


def _told(path: Path, as_json: bool) -> None:
    if as_json:
        print_json({"path": str(path), "size": path.stat().st_size})
    else:
        print(path)
