"""How long each store may be away, and how soon a lost worker's job goes on."""

import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil

from bench.machine import this_machine
from bench.result import Figure, Options, Result, Table, at_most, below
from bench.stack import Stack, running_stack
from bench.statistics import spread
from gaitway.client import Client
from gaitway.views import Event
from tests.faults.campaign.proxy import Mode
from tests.faults.campaign.world import STORES, World

_MINUTES = 10.0
_BEFORE_S, _AFTER_S = 10.0, 20.0
_STEP_S = 1.0
# The service's own, in the place of the short times of a campaign's world.
_DEFAULTS = {
    "GAITWAY_LEASE": "15",
    "GAITWAY_HEARTBEAT": "3",
    "GAITWAY_RECONCILE_EVERY": "1",
    "GAITWAY_GRACE": "60",
}
_NAMES = {"postgres": "PostgreSQL", "valkey": "Redis", "weed": "the object store"}
_HOW = {Mode.REFUSE: "refusing", Mode.SILENT: "silent"}

Row = dict[str, Any]


def measure(options: Options) -> Result:
    """Six services at once, each with one store away; then an embedded stack by itself."""
    machine = this_machine()
    minutes = options.minutes or (0.1 if options.quick else _MINUTES)
    cases = [(store, mode) for store in STORES for mode in (Mode.REFUSE, Mode.SILENT)]
    with ThreadPoolExecutor(len(cases)) as pool:
        running = [pool.submit(_outage, store, mode, minutes) for store, mode in cases]
        outages = [one.result() for one in running]
    rounds = 1 if options.quick else 5
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        starts = [_start(Path(folder, "start")) for _ in range(1 + rounds)]
        with running_stack(Path(folder, "stack"), workers=2) as stack:
            picked_up = [_pick_up_s(stack) for _ in range(2 * rounds)]
            lost = [_lost_worker(stack) for _ in range(rounds)]
    return Result(
        name="outages",
        title="Outages and lost workers",
        command="./run bench outages",
        quick=options.quick,
        machine=machine,
        figures=[
            Figure(
                name=f"steps that {minutes:g} minutes without a store cost, at most",
                value=float(max(row["steps_lost"] for row in outages)),
                unit="",
                target=below(1),
            ),
            Figure(
                name="attempts that it took, at most",
                value=float(max(row["attempts"] for row in outages)),
                unit="",
                target=at_most(1),
            ),
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
        rows=[*outages, *lost],
        table=Table(
            headings=["away", "how", "attempts", "steps", "all stored after the outage within"],
            rows=[
                [
                    _NAMES[row["store"]],
                    row["how"],
                    str(row["attempts"]),
                    f"{row['steps_kept']} of {row['steps']}",
                    f"{row['caught_up_s']:.1f} s",
                ]
                for row in outages
            ],
        ),
        notes=[
            "Outages: real servers and processes with the service's default times, and a training process of "
            f"one step a second that goes on for {_AFTER_S:.0f} s after the outage. A step is lost when its "
            "row of metrics is missing or is there twice. All six run side by side.",
            "A lost worker: one of two workers of the embedded stack, and all below it, is killed while it "
            "trains an ant; the job's next attempt is the other worker's, and starts JAX anew with compiled "
            "programs kept.",
        ],
    )


# ---- a store that is away --------------------------------------------------------------------------


def _outage(store: str, mode: Mode, minutes: float) -> Row:
    steps = round((_BEFORE_S + 60 * minutes + _AFTER_S) / _STEP_S)
    labels = {"steps": str(steps), "step_s": str(_STEP_S)}
    with World(settings=_DEFAULTS) as world:
        with Client(world.url) as client:
            job = client.submit(environment="inverted_pendulum", labels=labels)
            _until(lambda: len(_steps(client, job.id)) * _STEP_S >= _BEFORE_S)
        proxies = [proxy for name, proxy in world.proxies.all.items() if name.endswith(f"/{store}")]
        for proxy in proxies:
            proxy.mode = mode
        time.sleep(60 * minutes)
        for proxy in proxies:
            proxy.mode = Mode.OPEN
        healed, told_s = time.monotonic(), 60 * minutes
        with Client(world.url) as client:
            _until(lambda: len(_steps(client, job.id)) * _STEP_S >= told_s)
            caught_up_s = time.monotonic() - healed
            ended = client.wait(job.id, timeout=300)
            kept = _steps(client, job.id)
    expected = list(range(1, steps + 1))
    lost = len(set(expected) - set(kept)) + len(kept) - len(set(kept))
    return {
        "store": store,
        "how": _HOW[mode],
        "minutes": minutes,
        "status": ended.status,
        "attempts": len(ended.attempts),
        "steps": steps,
        "steps_kept": len(set(kept)),
        "steps_lost": lost + (not ended.succeeded),
        "caught_up_s": caught_up_s,
    }


def _steps(client: Client, job_id: str) -> list[int]:
    """Of the rows of metrics, as far as the service can tell them now."""
    with suppress(Exception):
        return [row.step for row in client.metrics(job_id)]
    return []


# ---- a worker that is lost -------------------------------------------------------------------------


def _lost_worker(stack: Stack) -> Row:
    with Client(stack.url) as client:
        _until(lambda: len(client.workers()) >= 2)
        job = client.submit(
            environment="ant",
            algorithm={"kind": "ppo", "num_timesteps": 100_000_000},
            checkpoints={"every_steps": 20_000},
        )
        _until(lambda: bool(client.checkpoints(job.id)))
        held = next(worker for worker in client.workers() if worker.job == job.id)
        family = psutil.Process(held.pid)
        killed = time.time()
        for process in (family, *family.children(recursive=True)):
            with suppress(psutil.NoSuchProcess):
                process.send_signal(signal.SIGKILL)
        later = [event for event in _until_it_trains(client, job.id, killed) if _moment(event) > killed]
        client.cancel(job.id)
        client.wait(job.id)
    seen = next(event for event in later if event.kind == "status" and event.data["status"] == "queued")
    return {"seen_s": _moment(seen) - killed, "training_s": _moment(later[-1]) - killed}


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
        _until(lambda: bool(client.get(job.id).attempts))
        begun = client.get(job.id)
        client.cancel(job.id)
        client.wait(job.id)
    claimed = begun.attempts[0].started_at
    if claimed is None:
        raise RuntimeError(f"The service did not say when job {job.id} was claimed.")
    return (claimed - begun.created_at).total_seconds()


def _start(data_dir: Path) -> float:
    """From the command to the sentence that says where the service is."""
    started = time.monotonic()
    command = [sys.executable, "-m", "gaitway.embedded.up", "--data", str(data_dir)]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True) as stack:
        line = "" if stack.stdout is None else stack.stdout.readline()
        ready_s = time.monotonic() - started
        stack.send_signal(signal.SIGINT)
        stack.wait(60)
    if re.search(r"http://", line) is None:
        raise RuntimeError(f"The stack did not start: {line}")
    return ready_s


def _until(holds: Callable[[], bool], timeout_s: float = 300.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not holds():
        if time.monotonic() > deadline:
            raise TimeoutError(f"It was not so within {timeout_s:.0f} s.")
        time.sleep(0.1)
