"""`./run demo`, `gaitway demo`: trains a body through the whole service, and fetches its video."""

import argparse
import contextlib
import shlex
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gaitway.battery import shown_battery
from gaitway.cli.progress import JobProgress
from gaitway.cli.terminal import Console
from gaitway.client import Client
from gaitway.errors import GaitwayError
from gaitway.schema import JobView
from gaitway.service.embedded.interruption import Interrupted
from gaitway.service.embedded.processes import ServerFailed
from gaitway.service.embedded.stack import Stack
from gaitway.service.embedded.up import port_number, positive, report
from gaitway.service.installed import PROGRAM

# An ant that keeps on its legs after so short a training: docs/environments/ant.md#an-ant-that-does-not-fall.
_ANT_OPTIONS = {"reset_noise_scale": 0.02, "ctrl_cost_weight": 1.0}
_ANT_LEARNS: dict[str, Any] = {
    "num_timesteps": 1_200_000,
    "discounting": 0.985,
    "learning_rate_schedule": "LINEAR",
}
# Robots that walk by command, which a battery tests in the end.
_ROBOTS = ("g1", "go1")


@dataclass(frozen=True)
class DemoOptions:
    """The demo's options."""

    out: Path
    environment: str
    num_timesteps: int | None
    seed: int
    port: int | None

    @property
    def data_dir(self) -> Path:
        return self.out / "data"

    def specification(self) -> dict[str, Any]:
        """The job to submit."""
        is_ant = self.environment == "ant"
        algorithm = {"kind": "ppo", **(_ANT_LEARNS if is_ant else {})}
        if self.num_timesteps:
            algorithm["num_timesteps"] = self.num_timesteps
        return {
            "kind": "train",
            "name": "first steps",
            "environment": {"id": "ant", "options": _ANT_OPTIONS} if is_ant else self.environment,
            "algorithm": algorithm,
            "seed": self.seed,
            **({"battery": True} if self.environment in _ROBOTS else {}),
        }


def run_demo(options: DemoOptions) -> int:
    """The exit status: 0 once the job has succeeded and its files are there."""
    options.out.mkdir(parents=True, exist_ok=True)
    report("Starting the service: records, object store, API, one worker …")
    job: JobView | None = None
    try:
        with (
            Stack(options.data_dir, port=options.port, report=report) as stack,
            stack.interruption.allowed(),
            Client(stack.url) as client,
        ):
            print(f"Gaitway is at {stack.url}  (its interface: {stack.url}/docs)", flush=True)
            started = time.monotonic()
            job = client.submit(options.specification())
            print(f"Job {job.id}, live: {stack.url}/#/jobs/{job.id}", flush=True)
            job = _follow(client, job)
            elapsed_s = time.monotonic() - started
            kept = _fetch(client, job, options.out)
            _report(job, kept, elapsed_s)
    except (ServerFailed, GaitwayError) as failure:
        report(f"The demo has failed: {failure}")
        _print_what_is_kept(options, job)
        return 1
    except Interrupted as interrupted:
        report("Interrupted; everything that the demo started has ended.")
        _print_what_is_kept(options, job)
        return interrupted.exit_status
    _print_what_is_kept(options, job)
    return 0 if job.succeeded else 1


def _follow(client: Client, job: JobView) -> JobView:
    with JobProgress(Console()) as progress:
        for event in client.events(job.id):
            progress.update(event)
        job = client.get(job.id)
        progress.update(job)
    return job


def _fetch(client: Client, job: JobView, out: Path) -> dict[str, Path]:
    """Fetch all results over HTTP; returns where each one is."""
    name, kept = job.environment or "body", dict[str, Path]()
    if job.newest("video") is not None:
        kept["video"] = client.video(job.id, out / f"{name}.mp4")
    if (poster := job.newest("poster")) is not None:
        kept["poster"] = client.poster(job.id, out / f"{name}{Path(poster.name).suffix}")
    if (policy := job.newest("policy")) is not None:
        kept["policy"] = client.download(
            job.id, policy.name, out / f"{name}-policy{Path(policy.name).suffix}"
        )
    if (battery := job.newest("battery")) is not None:
        kept["battery"] = client.download(job.id, battery.name, out / f"{name}-battery.json")
    kept["report"] = client.share(job.id, out / f"{name}-report.html")
    return kept


def _report(job: JobView, kept: dict[str, Path], elapsed_s: float) -> None:
    why = f": {job.message}" if job.message and not job.succeeded else ""
    print(f"\nThe job has {job.status} after {elapsed_s:.0f} s{why}")
    video = job.newest("video")
    speed = job.progress.metrics.get("eval/forward_speed")
    if video is not None:
        speed = video.metadata.get("forward_speed_m_s", speed)
    if speed is not None:
        where = "in the video" if video is not None else "in the last evaluation"
        print(f"The {job.environment} walks at {speed:.2f} m/s {where}.")
    if video is not None and (number := video.metadata.get("episodes", 1)) > 1:
        print(f"The video shows {number} episodes: the body fell, or an episode's time was up.")
    battery = job.newest("battery")
    if battery is not None and (shown := shown_battery(battery.metadata)) is not None:
        held = ", ".join(f"{name} {value} ({bound})" for name, value, bound, _ in shown.criteria)
        print(f"Battery: {shown.verdict} {held[0].upper()}{held[1:]}.")
    if video is None:
        print("There is no video: if this machine cannot render, `gaitway doctor` says what is missing.")
    for what, path in kept.items():
        print(f"  {what:15} {path}")


def _print_what_is_kept(options: DemoOptions, job: JobView | None) -> None:
    if job is None:
        return
    with contextlib.suppress(BrokenPipeError):
        command = f"{PROGRAM} up --data {shlex.quote(str(options.data_dir))}"
        print(f"The service has ended. To see job {job.id} on its page:  {command}", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog=f"{PROGRAM} demo", description="Train an ant, watch it, keep its video."
    )
    parser.add_argument(
        "--out", type=Path, default=Path("gaitway-demo"), metavar="DIR", help="for the results"
    )
    parser.add_argument("--environment", default="ant", metavar="ID", help="ant, hopper, go1, …")
    parser.add_argument("--timesteps", type=positive, metavar="N", help="environment steps to train for")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--port", type=port_number, help="of the API; by default 8000 or the next free one")
    chosen = parser.parse_args(arguments)
    return run_demo(
        DemoOptions(chosen.out.resolve(), chosen.environment, chosen.timesteps, chosen.seed, chosen.port)
    )


if __name__ == "__main__":
    sys.exit(main())
