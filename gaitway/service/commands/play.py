"""`gaitway play`: a body in a viewer."""

import hashlib
import re
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from gaitway.addresses import models_in
from gaitway.cli.common import client_of, complain, job_id, wrong_usage
from gaitway.cli.submit import Assignments, assigned, option
from gaitway.cli.watch import page_of
from gaitway.client import Client
from gaitway.policy import algorithm_of
from gaitway.schema import JobView
from gaitway.service.commands.services import require

Agent = Literal["zero", "random", "trained"]


def play(  # noqa: PLR0913 # A command line's options.
    context: typer.Context,
    target: Annotated[
        str, typer.Argument(metavar="ENVIRONMENT|JOB", help="An environment, e.g. ant; or a training's id.")
    ],
    agent: Annotated[
        Agent | None, typer.Option(help="By default trained for a job, random for an environment.")
    ] = None,
    best: Annotated[
        bool, typer.Option("--best", help="The policy of the job's best evaluation, not the last one.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Of the episodes, which are those of a rollout of it.")] = 0,
    model: Annotated[
        Path | None,
        typer.Option(exists=True, dir_okay=False, help="The model of your own that the environment takes."),
    ] = None,
    video: Annotated[
        bool, typer.Option("--video", help="Make a video and a replay, as where there is no display.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="Where files go; by default gaitway-play/ and the target's name.")
    ] = None,
    assignments: Assignments = None,
) -> None:
    """Show an environment, or the policy of a training, in MuJoCo's viewer on this machine.

    Where there is no display, it names the page of the job, or makes a video. On macOS: `mjpython
    .venv/bin/gaitway play …`.
    """
    require("worker", "jax", "mujoco", "brax", "structlog", "glfw")
    from core.environments.catalog import ENVIRONMENTS
    from core.errors import GaitwayError, Rejected
    from gaitway.service.foreground import parsed
    from gaitway.service.playing import has_display
    from gaitway.service.playing import play as start

    in_viewer = not video and has_display()
    with ExitStack() as stack:
        policy: tuple[Path, str | None] | None = None
        if target in ENVIRONMENTS:
            document = _of_environment(target, agent or "random", model)
        else:
            _check_is_a_job(target)
            client = client_of(context)
            job = client.get(job_id(client, target))
            document = _of_job(client, job, agent or "trained")
            if document["policy"]["kind"] == "checkpoint":
                if not in_viewer and not video:
                    print(f"There is no display here; the replay is at {page_of(client, job.id)}/replay")
                    return
                folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="gaitway-")))
                policy = _policy(client, job, folder, best=best)
            if model is None and "model" in document["environment"]["options"]:
                folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="gaitway-")))
                model = next(iter(models_in(client.export(job.id, folder), folder)), None)
        for text in assignments or ():
            assigned(document["environment"]["options"], option(text))
        try:
            spec: Any = parsed({**document, "seed": seed})
            folder = out or Path("gaitway-play", target.replace("/", "-"))
            made = start(spec, folder, model=model, policy=policy, in_viewer=in_viewer)
        except KeyboardInterrupt:
            return
        except Rejected as error:
            raise wrong_usage(error.detail) from None
        except GaitwayError as error:
            complain(error.detail)
            raise typer.Exit(1) from None
    if made is not None:
        print(f"{'There is no display here; the' if not video else 'The'} video is {made}")


def _check_is_a_job(target: str) -> None:
    """Raises typer.Exit, with the nearest environment, for what can be no job's id."""
    from core.environments.catalog import find
    from core.errors import EnvironmentNotFound

    if target == "last" or re.fullmatch(r"[0-9a-f-]+", target):
        return
    try:
        find(target)
    except EnvironmentNotFound as error:
        raise wrong_usage(error.detail) from None


def _of_environment(name: str, agent: Agent, model: Path | None) -> dict[str, Any]:
    if agent == "trained":
        raise wrong_usage("An environment has no trained policy: name a job, e.g. `gaitway play last`.")
    options: dict[str, Any] = {}
    if model is not None:
        options["model"] = f"sha256:{hashlib.sha256(model.read_bytes()).hexdigest()}"
    environment = {"id": name, "options": options}
    return {"kind": "rollout", "environment": environment, "policy": {"kind": agent}}


def _of_job(client: Client, job: JobView, agent: Agent) -> dict[str, Any]:
    if job.kind != "train":
        raise wrong_usage(f"Job {job.id} is a rollout: play the training whose policy it ran.")
    spec = client.specification(job.id)
    policy = {"kind": "checkpoint", "job": job.id} if agent == "trained" else {"kind": agent}
    kept = {name: spec[name] for name in ("environment", "randomization") if name in spec}
    length = spec["algorithm"].get("episode_length")
    steps = {} if length is None else {"num_steps": length}
    return {"kind": "rollout", **kept, "policy": policy, **steps}


def _policy(client: Client, job: JobView, folder: Path, *, best: bool) -> tuple[Path, str | None]:
    """The file of the policy, and its algorithm; the newest checkpoint of a training that has not ended."""
    seed = job.seeds[0] if job.seeds else None
    file = job.newest("best_policy" if best else "policy", seed=seed)
    if file is not None:
        return client.download(job.id, file.name, folder / "policy"), algorithm_of(job)
    checkpoint = None if best or job.seeds else job.newest("checkpoint")
    if checkpoint is None:
        raise wrong_usage(f"Job {job.id} has no such policy yet.")
    return client.download(job.id, checkpoint.name, folder / "policy"), None
