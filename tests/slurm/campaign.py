"""Disturbances at random moments, drawn from a seed, while small trainings run on a real Slurm.

`python -m tests.slurm.campaign --disturbances 100 --seed 0` prints a line of JSON for each, and a summary. At
the end every job must have succeeded once, with the bytes of a training that nobody disturbed.
"""

import argparse
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import psutil

from tests.slurm.local_slurm import missing, wait_until
from tests.slurm.world import World, result

_OPTIONS = """
max = 3
idle = 10
grace = 10
start_margin = 15
tunnel = "none"
[cpu]
partition = "low"
cpus = 2
mem = "2G"
{limit}
"""
_STEPS = 320_000
_SEEDS = range(2)
_AT_WORK = 3
_PAUSES_S = (2.0, 9.0)


class Disturbances:
    """What is done to the workers and to Slurm. Each returns to what; None if it found nothing."""

    def __init__(self, world: World, rng: random.Random) -> None:
        self._world, self._rng = world, rng

    def draw(self) -> Callable[[], str | None]:
        kinds = (
            (self.preempt, 5),
            (self.cancel, 4),
            (self.kill, 3),
            (self.power_off, 3),
            (self.lose_node, 3),
            (self.kill_slurmd, 2),
            (self.restart_controller, 2),
            (self.requeue, 3),
            (self.restart_launcher, 1),
            (self.limit_time, 3),
        )
        return self._rng.choices([kind for kind, _ in kinds], [weight for _, weight in kinds])[0]

    def preempt(self) -> str | None:
        node = self._rng.choice(("n1", "n2"))
        seconds = self._rng.randint(1, 4)
        self._slurm(
            "sbatch", "-p", "high", "-w", node, "-n1", "-c4", "--output=/dev/null", f"--wrap=sleep {seconds}"
        )
        return node

    def cancel(self) -> str | None:
        return self._of_one("scancel")

    def requeue(self) -> str | None:
        return self._of_one("scontrol", "requeue")

    def kill(self) -> str | None:
        return self._of_one("scancel", "--signal=KILL", "--full")

    def power_off(self) -> str | None:
        """Every process of an allocation ends at the same moment, and keeps nothing."""
        job = self._one()
        if job is None:
            return None
        everyone = [one for one in psutil.process_iter() if _is_of(one, job)]
        for number in (signal.SIGSTOP, signal.SIGKILL):
            for one in everyone:
                with suppress(psutil.NoSuchProcess):
                    one.send_signal(number)
        return job

    def limit_time(self) -> str | None:
        """A limit of a minute, of which most has passed: Slurm ends it at its next look."""
        job = self._one()
        if job is not None:
            self._slurm("scontrol", "update", f"jobid={job}", "timelimit=1")
        return job

    def lose_node(self) -> str | None:
        node = self._rng.choice(("n1", "n2"))
        self._slurm("scontrol", "update", f"nodename={node}", "state=down", "reason=test")
        time.sleep(self._rng.uniform(0.5, 3.0))
        self._slurm("scontrol", "update", f"nodename={node}", "state=resume")
        return node

    def kill_slurmd(self) -> str | None:
        node = self._rng.choice(("n1", "n2"))
        self._world.slurm.stop(node, signal.SIGKILL)
        time.sleep(self._rng.uniform(0.5, 6.0))
        self._world.slurm.start(node)
        return node

    def restart_controller(self) -> str | None:
        self._world.slurm.stop("slurmctld", self._rng.choice((signal.SIGTERM, signal.SIGKILL)))
        time.sleep(self._rng.uniform(0.5, 5.0))
        self._world.slurm.start("slurmctld")
        return "slurmctld"

    def restart_launcher(self) -> str | None:
        self._world.restart_cluster(self._rng.choice((signal.SIGTERM, signal.SIGKILL)))
        return "gaitway cluster"

    def _one(self) -> str | None:
        running = [job for job, state, _ in self._world.allocations() if state == "RUNNING"]
        return self._rng.choice(running) if running else None

    def _of_one(self, *command: str) -> str | None:
        job = self._one()
        if job is not None:
            self._slurm(*command, job)
        return job

    def _slurm(self, *command: str) -> None:
        self._world.slurm.command(*command, check=False)


def _is_of(process: psutil.Process, job: str) -> bool:
    """Another Slurm of this machine may have a job of the same number."""
    try:
        found = process.environ()
    except psutil.Error:
        return False
    return (found.get("SLURM_JOB_ID"), found.get("SLURM_CONF")) == (job, os.environ["SLURM_CONF"])


def run(world: World, number: int, seed: int) -> int:
    """The number of broken promises."""
    rng = random.Random(seed)
    world.keep_workers(_OPTIONS.format(limit=""))
    undisturbed = {one: _undisturbed(world, one) for one in _SEEDS}
    print(
        json.dumps({"undisturbed": {str(key): len(value) for key, value in undisturbed.items()}}), flush=True
    )
    jobs = dict[str, int]()
    counts, done, began = Counter[str](), 0, time.monotonic()
    disturbances = Disturbances(world, rng)
    while done < number:
        at_work = [job for job in jobs if not world.client.get(job).is_final]
        for _ in range(_AT_WORK - len(at_work)):
            own = rng.choice(_SEEDS)
            jobs[world.submit(_STEPS, own, max_attempts=100)] = own
        time.sleep(rng.uniform(*_PAUSES_S))
        disturb = disturbances.draw()
        to = disturb()
        if to is None:
            continue
        done += 1
        counts[disturb.__name__] += 1
        print(
            json.dumps(
                {
                    "number": done,
                    "at_s": round(time.monotonic() - began, 1),
                    "disturbance": disturb.__name__,
                    "to": to,
                    "jobs": len(jobs),
                }
            ),
            flush=True,
        )
    broken = list(_broken(world, jobs, undisturbed))
    wait_until(lambda: not world.allocations(), 180)
    attempts = Counter(str(attempt.reason) for job in jobs for attempt in world.client.get(job).attempts)
    print(
        json.dumps(
            {
                "seed": seed,
                "disturbances": dict(counts),
                "jobs": len(jobs),
                "attempts": dict(attempts),
                "allocations": len(world.worker_logs()),
                "seconds": round(time.monotonic() - began),
                "broken": broken,
            }
        ),
        flush=True,
    )
    return len(broken)


def _undisturbed(world: World, seed: int) -> Mapping[str, str]:
    job = world.ended(world.submit(_STEPS, seed))
    assert len(job.attempts) == 1
    return result(job)


def _broken(world: World, jobs: Mapping[str, int], undisturbed: Mapping[int, Mapping[str, str]]) -> list[str]:
    broken = list[str]()
    for job_id, seed in jobs.items():
        try:
            job = world.ended(job_id, 900)
        except TimeoutError as error:
            broken.append(f"{job_id}: {str(error)[:500]}")
            continue
        if job.status != "succeeded":
            broken.append(f"{job_id}: {job.status}, {job.reason}: {job.message}")
        elif result(job) != undisturbed[seed]:
            broken.append(f"{job_id}: other bytes than an undisturbed run of seed {seed}")
        ends = [attempt.number for attempt in job.attempts if attempt.reason == "completed"]
        if len(ends) != 1:
            broken.append(f"{job_id}: it was completed {len(ends)} times")
        steps = [row.step for row in world.client.metrics(job_id)]
        if len(steps) != len(set(steps)):
            broken.append(f"{job_id}: its metrics have a step twice")
    return broken


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--disturbances", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    said = parser.parse_args()
    if (sentence := missing()) is not None:
        sys.exit(sentence)
    with tempfile.TemporaryDirectory(prefix="gw-") as folder, World(Path(folder), kill_wait_s=15) as world:
        broken = run(world, said.disturbances, said.seed)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
