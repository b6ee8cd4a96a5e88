"""The demo: its job on a fresh stack with nothing compiled; with --fresh-clone also the whole command.

With --models, users' robots instead: each file is added to the service, and the job of its recipe
(docs/robots.md) is submitted as it is, but for what --options says.

A fresh clone has an empty environment; packages come from the machine's package cache or from the network, as
uv finds them. Speed is along x over the whole video, falls and new starts included.
"""

import argparse
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bench.stack import running_stack
from bench.summary import Figure
from gaitway.client import Client
from gaitway.errors import Rejected
from gaitway.schema import JobView
from gaitway.service.demo import DemoOptions
from gaitway.views import Event

# Seconds from the submission to the video, and to the battery of a robot.
_MOST_S = {"ant": 60, "go1": 240}
_QUICK = {"num_timesteps": 20_480, "num_eval_envs": 2, "episode_length": 20, "num_evals": 1}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--environment", default="ant", choices=list(_MOST_S), help="by default the ant")
    parser.add_argument("--fresh-clone", action="store_true", help="also from a clone without .venv")
    parser.add_argument(
        "--models", nargs="+", type=Path, metavar="FILE", help="robots by their recipes instead"
    )
    parser.add_argument(
        "--options", type=json.loads, default={}, metavar="JSON", help="of the recipes; `edits` add to theirs"
    )


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    """When the job starts to train, when there is a video, and whether its body walks."""
    if arguments.models:
        yield from _users_robots(arguments)
        return
    body = arguments.environment
    specification = DemoOptions(Path(), body, num_timesteps=None, seed=0, port=None).specification()
    if arguments.quick:
        specification |= {"algorithm": {"kind": "ppo", **_QUICK}, "video": {"seconds": 0.5}}
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        began = time.time()
        with running_stack(Path(folder, "data")) as stack, Client(stack.url) as client:
            yield Figure("the stack is ready", time.time() - began, "s")
            moments, job = _follow(client, specification)
        for what, seconds in moments.items():
            target = _MOST_S[body] if what in ("the video", "the battery") else None
            yield Figure(f"submission to {what}", seconds, "s", at_most=target)
        shown = job.newest("video")
        if job.newest("battery") is not None:
            yield from _battery(job)
        elif shown is not None:
            speed, episodes = (float(shown.metadata[name]) for name in ("forward_speed_m_s", "episodes"))
            yield Figure("forward speed in the video", speed, "m/s", at_least=1)
            yield Figure("new starts after a fall in the video", episodes - 1, at_most=0)
        if arguments.fresh_clone:
            seconds = _fresh_clone_s(Path(folder, "clone"))
            yield Figure("`git clone` and `./run demo`, whole", seconds, "s", at_most=60)


def _users_robots(arguments: argparse.Namespace) -> Iterator[Figure]:
    """One after another on one service: the seconds to its policy's battery, and what that found."""
    with (
        tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder,
        running_stack(Path(folder, "data")) as stack,
        Client(stack.url) as client,
    ):
        for path in arguments.models:
            name, began = path.stem, time.time()
            job = client.add_model(path, name=name).recipe_job
            yield Figure(f"{name}: its file is read and tried", time.time() - began, "s")
            if job is None:
                yield Figure(f"{name}: submission to the battery", None, "s", missing="no recipe")
                continue
            options = job["environment"]["options"]
            edits = options.get("edits", {}) | arguments.options.get("edits", {})
            options |= arguments.options | {"edits": edits}
            if arguments.quick:
                job |= {"algorithm": {"kind": "ppo", **_QUICK}, "battery": {"starts": 2, "seconds": 2}}
            try:
                moments, ended = _follow(client, job)
            except (RuntimeError, Rejected) as error:
                yield Figure(f"{name}: submission to the battery", None, "s", missing=str(error))
                continue
            yield Figure(f"{name}: submission to the battery", moments["the battery"], "s")
            yield from _battery(ended, f"{name}: ")


def _battery(job: JobView, prefix: str = "") -> Iterator[Figure]:
    """The job's last battery by its criteria."""
    battery = job.newest("battery")
    for one in battery.metadata["criteria"] if battery else []:
        least, most = (one["bound"], None) if "tracking" in one["quantity"] else (None, one["bound"])
        yield Figure(f"{prefix}battery, {one['quantity']}", one["value"], at_least=least, at_most=most)


def _follow(client: Client, specification: dict[str, Any]) -> tuple[dict[str, float], JobView]:
    """Seconds from the submission to each moment, and the ended job. Raises RuntimeError if it failed."""
    submitted = time.time()
    job = client.submit(specification)
    moments: dict[str, float] = {}
    for event in client.events(job.id):
        moment = _moment(event)
        if moment is not None and event.time is not None:
            moments.setdefault(moment, event.time.timestamp() - submitted)
    job = client.get(job.id)
    if not job.succeeded or "the video" not in moments:
        log = "\n".join(list(client.logs(job.id))[-20:])
        raise RuntimeError(f"Job {job.id} {job.status}, its video is missing: {job.message}\n{log}")
    return moments, job


def _moment(event: Event) -> str | None:
    """A newcomer's name for this event, if it matters to one."""
    match event.kind:
        case "phase" if event.data["name"] == "process":
            return "the training process"
        case "progress":
            return "the first progress"
        case "artifact" if event.data["role"] == "video":
            return "the video"
        case "artifact" if event.data["role"] == "battery":
            return "the battery"
        case "status" if event.is_end:
            return "the end of the job"
        case _:
            return None


def _fresh_clone_s(folder: Path) -> float:
    """Seconds of `git clone` and `./run demo`. Raises RuntimeError with the end of their output."""
    environment = {name: value for name, value in os.environ.items() if name != "VIRTUAL_ENV"}
    clone, demo = ["git", "clone", "--quiet", str(Path.cwd()), str(folder)], ["./run", "demo", "--out", "out"]
    began = time.perf_counter()
    for command, where in ((clone, Path.cwd()), (demo, folder)):
        done = subprocess.run(
            command, cwd=where, env=environment, capture_output=True, text=True, check=False, timeout=1200
        )
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr[-3000:]}")
    return time.perf_counter() - began
