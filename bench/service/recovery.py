"""Times the resumption of a lost worker's job, the claim of a new one, and the start of the stack."""

import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil

from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result, at_most
from bench.measure.statistics import spread
from bench.stack.embedded import Stack, running_stack
from bench.stack.waiting import until
from gaitway.client import Client
from gaitway.views import Event

Row = dict[str, Any]


def measure(options: Options) -> Result:
    """Start an embedded stack repeatedly; then submit jobs to one with two workers, and kill a worker."""
    machine = this_machine()
    rounds = 1 if options.quick else 5
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        starts = [_start(Path(folder, "start")) for _ in range(1 + rounds)]
        with running_stack(Path(folder, "stack"), workers=2) as stack:
            picked_up = [_pick_up_s(stack) for _ in range(2 * rounds)]
            lost = [_lost_worker(stack) for _ in range(rounds)]
    return Result(
        name="recovery",
        title="Recovery",
        command="./run bench recovery",
        quick=options.quick,
        machine=machine,
        figures=[
            Figure.of(
                "from the kill of a worker to the job's return to the queue",
                spread([row["seen_s"] for row in lost]),
                "s",
                at_most(15),
            ),
            Figure.of(
                "from the kill of a worker to the next training step",
                spread([row["training_s"] for row in lost]),
                "s",
                at_most(30),
            ),
            Figure.of("from the submission to its worker's claim", spread(picked_up), "s", at_most(1)),
            Figure(name="the stack's first start", value=starts[0], unit="s", target=at_most(3)),
            Figure.of("a later start of the stack", spread(starts[1:]), "s", at_most(3)),
        ],
        rows=[*lost, *({"picked_up_s": seconds} for seconds in picked_up)],
        notes=[
            "A lost worker: one of the embedded stack's two workers is killed, with all its processes, while "
            "it trains an ant. When its lease of 14 s has run out, the other worker takes the next attempt; "
            "its new training process finds the compiled programs in the cache.",
        ],
    )


def _lost_worker(stack: Stack) -> Row:
    with Client(stack.url) as client:
        until(lambda: len(list(client.workers())) >= 2)
        job = client.submit(
            environment="ant",
            algorithm={"kind": "ppo", "num_timesteps": 100_000_000},
            checkpoints={"every_steps": 20_000},
        )
        until(lambda: bool(client.checkpoints(job.id)))
        # A worker reports its job only every few seconds.
        until(lambda: bool(_pids_with(client, job.id)))
        family = psutil.Process(_pids_with(client, job.id)[0])
        killed = time.time()
        for process in (family, *family.children(recursive=True)):
            with suppress(psutil.NoSuchProcess):
                process.send_signal(signal.SIGKILL)
        later = [event for event in _until_it_trains(client, job.id, killed) if _moment(event) > killed]
        client.cancel(job.id)
        client.wait(job.id)
    seen = next(event for event in later if event.kind == "status" and event.data["status"] == "queued")
    return {"seen_s": _moment(seen) - killed, "training_s": _moment(later[-1]) - killed}


def _pids_with(client: Client, job_id: str) -> list[int]:
    return [worker.pid for worker in client.workers() if worker.job == job_id and worker.pid is not None]


def _until_it_trains(client: Client, job_id: str, since: float) -> Iterator[Event]:
    for event in client.events(job_id):
        yield event
        if event.kind == "progress" and _moment(event) > since:
            return


def _moment(event: Event) -> float:
    return 0.0 if event.time is None else event.time.timestamp()


def _pick_up_s(stack: Stack) -> float:
    with Client(stack.url) as client:
        job = client.submit(environment="inverted_pendulum")
        until(lambda: bool(client.get(job.id).attempts))
        begun = client.get(job.id)
        client.cancel(job.id)
        client.wait(job.id)
    claimed = begun.attempts[0].started_at
    if claimed is None:
        raise RuntimeError(f"The service did not say when job {job.id} was claimed.")
    return (claimed - begun.created_at).total_seconds()


def _start(data_dir: Path) -> float:
    """Seconds from the command until it prints the service's address."""
    started = time.monotonic()
    command = [sys.executable, "-m", "gaitway.service.embedded.up", "--data", str(data_dir)]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True) as stack:
        line = "" if stack.stdout is None else stack.stdout.readline()
        ready_s = time.monotonic() - started
        stack.send_signal(signal.SIGINT)
        stack.wait(60)
    if re.search(r"http://", line) is None:
        raise RuntimeError(f"The stack did not start: {line}")
    return ready_s
