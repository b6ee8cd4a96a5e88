"""The demo's job on a fresh stack; with --fresh-clone also the whole command from a clone without a venv."""

import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result, at_least, at_most
from bench.stack.embedded import running_stack
from gaitway.client import Client
from gaitway.schema import JobView
from gaitway.service.demo import DemoOptions
from gaitway.views import Event

_TARGETS = {"the video": at_most(60)}
_CLONE_S = 1200.0


def measure(options: Options) -> Result:
    """Measure when the job starts to train, when there is a video, and whether its ant walks."""
    machine = this_machine()
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        began = time.time()
        with running_stack(Path(folder, "data")) as stack, Client(stack.url) as client:
            started_s = time.time() - began
            moments, job = _follow(client, _job(options))
            shown = _shown_in_video(job)
            Path(folder, "downloads").mkdir()
            client.video(job.id, Path(folder, "downloads"))
        clone = _fresh_clone(Path(folder, "clone")) if options.fresh_clone else []
    return Result(
        name="demo",
        title="The demo",
        command="./run bench demo" + (" --fresh-clone" if options.fresh_clone else ""),
        quick=options.quick,
        machine=machine,
        figures=[
            Figure(name="the stack is ready", value=started_s, unit="s"),
            *(
                Figure(name=f"submission to {what}", value=value, unit="s", target=_TARGETS.get(what))
                for what, value in moments.items()
            ),
            Figure(name="forward speed in the video", value=shown["speed"], unit="m/s", target=at_least(1)),
            Figure(
                name="new starts after a fall in the video", value=shown["falls"], unit="", target=at_most(0)
            ),
            *clone,
        ],
        rows=[{"job": job.id, "steps": job.progress.step, **job.progress.metrics}],
        notes=[
            "The stack and its caches are new: everything is compiled. Speed is along x over the whole "
            "video, falls and new starts included.",
            "A fresh clone has an empty venv; packages come from the machine's package cache or from the "
            "network, as `uv` finds them.",
        ],
    )


def _job(options: Options) -> dict[str, Any]:
    """The demo's own job; a tiny one for a smoke test."""
    job = DemoOptions(Path(), "ant", num_timesteps=None, seed=0, port=None).specification()
    if not options.quick:
        return job
    tiny = {"kind": "ppo", "num_timesteps": 20_480, "num_eval_envs": 2, "episode_length": 20, "num_evals": 1}
    return {**job, "algorithm": tiny, "video": {"seconds": 0.5}}


def _follow(client: Client, spec: dict[str, Any]) -> tuple[dict[str, float], JobView]:
    """Seconds from the submission to each moment, and the ended job. Raises RuntimeError if it failed."""
    submitted = time.time()
    job = client.submit(spec)
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
        case "status" if event.is_end:
            return "the end of the job"
        case _:
            return None


def _shown_in_video(job: JobView) -> dict[str, float]:
    """The speed, m/s, and how often the body starts anew. Raises RuntimeError if the video does not say."""
    video = job.newest("video")
    if video is None or not {"forward_speed_m_s", "episodes"} <= video.metadata.keys():
        raise RuntimeError(f"The video of job {job.id} does not say how the body went.")
    return {"speed": float(video.metadata["forward_speed_m_s"]), "falls": video.metadata["episodes"] - 1}


def _fresh_clone(folder: Path) -> list[Figure]:
    """`git clone` and `./run demo`, timed together. Raises RuntimeError with the end of their output."""
    git = shutil.which("git")
    if git is None:
        raise RuntimeError("There is no git to clone with.")
    environment = {name: value for name, value in os.environ.items() if name != "VIRTUAL_ENV"}
    began = time.perf_counter()
    for command, where in (
        ([git, "clone", "--quiet", str(Path.cwd()), str(folder)], Path.cwd()),
        (["./run", "demo", "--out", str(folder / "out")], folder),
    ):
        done = subprocess.run(
            command,
            cwd=where,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
            timeout=_CLONE_S,
        )
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stdout[-3000:]}")
    seconds = time.perf_counter() - began
    return [Figure(name="`git clone` and `./run demo`, whole", value=seconds, unit="s", target=at_most(60))]
