"""`gaitway profile`: where the time of a training goes."""

from pathlib import Path
from typing import Annotated

import typer

from gaitway.cli.common import complain, wrong_usage
from gaitway.cli.submit import Assignments, assigned, name_the_algorithm, read, whole_path
from gaitway.service.commands.services import require


def profile(  # noqa: PLR0913 # A command line's options.
    file: Annotated[str, typer.Argument(metavar="JOB.json", help="The job's document; `-` reads stdin.")],
    epochs: Annotated[int, typer.Option(min=1, help="How many to train for, of a second each.")] = 5,
    trace: Annotated[
        Path | None,
        typer.Option(
            file_okay=False, help="A folder for the trace of one more, for TensorBoard or Perfetto."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Where files go; by default gaitway-profile/ and the file's name.")
    ] = None,
    gpus: Annotated[int, typer.Option(min=0, help="On so many GPUs; 0 is the CPU.")] = 0,
    model: Annotated[
        Path | None,
        typer.Option(exists=True, dir_okay=False, help="The model of your own that the job names."),
    ] = None,
    assignments: Assignments = None,
) -> None:
    """Train a job for some epochs in this process, and print where its time goes.

    Experience and physics are compiled and timed again alone; learning and policy are what is left. Their
    shares are those of the updates. Q-learning, which learns from every step, has no such parts.
    """
    require("worker", "jax", "mujoco", "brax", "structlog")
    document = read(file)
    for text in assignments or ():
        assigned(document, whole_path(text))
    name_the_algorithm(document)
    from core.errors import GaitwayError, Rejected
    from gaitway.service.profiling import profile as lines

    folder = out or Path("gaitway-profile", "stdin" if file == "-" else Path(file).stem)
    try:
        for line in lines(document, folder, gpus=gpus, model=model, epochs=epochs, trace=trace):
            print(line)
    except Rejected as error:
        raise wrong_usage(error.detail) from None
    except GaitwayError as error:
        complain(error.detail)
        raise typer.Exit(1) from None
