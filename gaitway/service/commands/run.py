"""`gaitway run`: one training in the foreground."""

from pathlib import Path
from typing import Annotated

import typer

from gaitway.cli.common import complain, wrong_usage
from gaitway.cli.submit import Assignments, assigned, name_the_algorithm, read, whole_path
from gaitway.service.commands.services import require


def run(
    file: Annotated[str, typer.Argument(metavar="JOB.json", help="The job's document; `-` reads stdin.")],
    out: Annotated[
        Path | None, typer.Option(help="Where its files go; by default gaitway-run/ and the file's name.")
    ] = None,
    gpus: Annotated[int, typer.Option(min=0, help="On so many GPUs; 0 is the CPU.")] = 0,
    model: Annotated[
        Path | None,
        typer.Option(exists=True, dir_okay=False, help="The model of your own that the job names."),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(exists=True, dir_okay=False, help="Go on from this checkpoint of the same job."),
    ] = None,
    assignments: Assignments = None,
) -> None:
    """Train a job in this process, without a service, and keep its files in a folder.

    Ctrl-C ends it with a checkpoint, and exit code 130; a second one ends it at once. A debugger works:
    `python -m pdb .venv/bin/gaitway run JOB.json`.
    """
    require("worker", "jax", "mujoco", "brax", "structlog")
    document = read(file)
    for text in assignments or ():
        assigned(document, whole_path(text))
    name_the_algorithm(document)
    from core.errors import GaitwayError, Rejected
    from gaitway.service.foreground import run_job

    folder = out or Path("gaitway-run", "stdin" if file == "-" else Path(file).stem)
    try:
        status = run_job(document, folder, gpus=gpus, model=model, resume=resume)
    except Rejected as error:
        raise wrong_usage(error.detail) from None
    except GaitwayError as error:
        complain(error.detail)
        raise typer.Exit(1) from None
    raise typer.Exit(status)
