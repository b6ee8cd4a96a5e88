"""The service's costs of a submission, a start and a training run, and the memory of its API process."""

import asyncio
import os
import tempfile
import time
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import psutil

from bench.measure.child import run_child
from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result, below
from bench.measure.statistics import Spread, alternate, percentile, spread
from bench.stack.embedded import Stack, running_stack
from bench.stack.open_loop import post_at_rate, remove
from gaitway.client import Client

_PER_SECOND = 100.0
_UNWANTED = ("jaxlib", "libmujoco")
_TIMEOUT_S = 1800.0

Row = dict[str, Any]


def measure(options: Options) -> Result:
    """Measure each part on a fresh embedded stack with one worker for the CPU."""
    machine = this_machine()
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        with running_stack(Path(folder, "first")) as stack:
            submitted, submissions = _submissions(stack, 100 if options.quick else 1000)
            api, memory = _api_process(stack)
            started, starts = _starts(stack, 1 if options.quick else 5)
        with running_stack(Path(folder, "second")) as stack:
            overhead, runs = _overhead(stack, Path(folder, "direct"), options)
    return Result(
        name="service",
        title="The service",
        command="./run bench service",
        quick=options.quick,
        machine=machine,
        figures=[*submitted, *api, *started, *overhead],
        rows=[*submissions, memory, *starts, *runs],
        notes=_notes(len(submissions), memory, {run["final_return"] for run in runs}),
    )


def _notes(count: int, memory: Row, returns: set[float]) -> list[str]:
    agreement = "the same return" if len(returns) == 1 else f"DIFFERENT returns: {sorted(returns)}"
    return [
        f"Submissions: {count} `POST /jobs` over loopback at {_PER_SECOND:g} a second, due at fixed times, "
        "whether or not the answers keep up; each is timed from when it was due. Each is one durable "
        "transaction in "
        "PostgreSQL, and its message is in the queue, before it is answered. The load generator, the "
        "servers and "
        "the idle worker share the machine.",
        "First line: from just before the POST to the time of the event `process`, which the training "
        "process causes before it imports anything; the worker was idle.",
        "Overhead: the same settings, seed and checkpoints through the service and by calling the trainer in "
        "a process, alternating; each side keeps its compiled programs from round to round, and the idle "
        "service runs beside the direct calls. Training is from the first update to the last evaluation; the "
        "whole is from the POST, or the start of the process, to the last evaluation. The video, which a "
        f"direct call does not make, is the row after it. All runs end with {agreement}.",
        f"The API process was looked at after the submissions; its memory map shows {_shown(memory)}.",
    ]


def _submissions(stack: Stack, count: int) -> tuple[list[Figure], list[Row]]:
    # For an accelerator that no worker here has: the jobs wait until they are removed.
    body = {"kind": "train", "environment": "ant", "resources": {"accelerator": "gpu"}}
    _, warm_up = asyncio.run(post_at_rate(stack.url, body, per_second=20, count=20))
    before = stack.cpu_s()
    seconds, jobs = asyncio.run(post_at_rate(stack.url, body, per_second=_PER_SECOND, count=count))
    used = {name: 1000 * (after - before.get(name, 0.0)) / count for name, after in stack.cpu_s().items()}
    asyncio.run(remove(stack.url, [*warm_up, *jobs]))
    figures = [
        Figure(
            name=f"`POST /jobs`, {percent}th percentile",
            value=1000 * percentile(seconds, percent),
            unit="ms",
            target=target,
        )
        for percent, target in ((50, None), (99, below(25)))
    ]
    figures += [
        Figure(name=f"processor time of a submission, {name}", value=used.get(name, 0.0), unit="ms")
        for name in ("api", "postgres", "valkey-server")
    ]
    return figures, [
        {"part": "submission", "number": number, "ms": 1000 * s} for number, s in enumerate(seconds)
    ]


def _api_process(stack: Stack) -> tuple[list[Figure], Row]:
    process = max(stack.api_processes(), key=lambda one: one.memory_info().rss)
    megabytes = process.memory_info().rss / 1e6
    maps = _mapped(process)
    loaded = None if maps is None else sum(name in maps for name in _UNWANTED)
    figures = [Figure(name="API process, resident", value=megabytes, unit="MB", target=below(120))]
    return figures, {"part": "api_process", "resident_mb": megabytes, "unwanted_libraries": loaded}


def _mapped(process: psutil.Process) -> str | None:
    """The files that the process has mapped; None if the system does not show them."""
    path = Path(f"/proc/{process.pid}/maps")
    return path.read_text() if path.exists() else None


def _shown(memory: Row) -> str:
    if memory["unwanted_libraries"] is None:
        return "nothing on this system"
    return f"{memory['unwanted_libraries']} of {' and '.join(_UNWANTED)}"


def _starts(stack: Stack, rounds: int) -> tuple[list[Figure], list[Row]]:
    with Client(stack.url) as client:
        seconds = [_first_line_s(client) for _ in range(rounds)]
    figure = Figure.of("POST to the training process's first line", spread(seconds), "s", below(1))
    return [figure], [{"part": "start", "round": turn, "s": value} for turn, value in enumerate(seconds)]


def _first_line_s(client: Client) -> float:
    """Seconds from a submission to the event `process`; the job is then cancelled and waited for."""
    submitted = time.time()
    job = client.submit(environment="ant", video={"seconds": 0.1, "width": 16, "height": 16})
    for event in client.events(job.id):
        if event.kind == "phase" and event.data["name"] == "process":
            client.cancel(job.id)
            client.wait(job.id, timeout=300)
            return _timestamp(event.time) - submitted
    raise RuntimeError(f"Job {job.id} never had a training process; its log says:\n{_log(client, job.id)}")


def _overhead(stack: Stack, cache: Path, options: Options) -> tuple[list[Figure], list[Row]]:
    cache.mkdir()
    small = {"num_eval_envs": 2, "episode_length": 20} if options.quick else {}
    settings = {"num_timesteps": 60_000 if options.quick else 600_000, **small}
    runs = alternate(
        1 if options.quick else 2,
        service=partial(_through_the_service, stack, settings),
        direct=partial(_directly, cache, settings),
    )
    pairs = list(zip(runs["service"], runs["direct"], strict=True))
    figures = [
        Figure.of("ant training through the service, whole", _of(runs["service"], "whole_s"), "s"),
        Figure.of("the same directly, whole", _of(runs["direct"], "whole_s"), "s"),
        Figure.of("overhead of the service, whole", _overhead_of(pairs, "whole_s"), "%", below(3)),
        Figure.of("overhead of the service, training", _overhead_of(pairs, "training_s"), "%", below(3)),
        Figure.of(
            "from the last evaluation to `succeeded`, video included", _of(runs["service"], "after_s"), "s"
        ),
    ]
    rows = [
        {"part": "overhead", "how": how, "round": turn, **run}
        for how, of_one in runs.items()
        for turn, run in enumerate(of_one)
    ]
    return figures, rows


def _of(runs: list[Row], name: str) -> Spread:
    return spread([run[name] for run in runs])


def _overhead_of(pairs: list[tuple[Row, Row]], name: str) -> Spread:
    return spread([100 * (service[name] / direct[name] - 1) for service, direct in pairs])


def _through_the_service(stack: Stack, settings: Row) -> Row:
    with Client(stack.url) as client:
        submitted = time.time()
        job = client.submit(environment="ant", algorithm={"kind": "ppo", **settings})
        events = list(client.events(job.id))
        job = client.get(job.id)
        if not job.succeeded or job.finished_at is None:
            raise RuntimeError(f"Job {job.id} {job.status}: {job.message}\n{_log(client, job.id)}")
    first = next(e for e in events if e.kind == "phase" and e.data["name"] == "first_update")
    last = [e for e in events if e.kind == "metrics" and "eval/episode_reward" in e.data["values"]][-1]
    return {
        "whole_s": _timestamp(last.time) - submitted,
        "training_s": _timestamp(last.time) - _timestamp(first.time),
        "after_s": job.finished_at.timestamp() - _timestamp(last.time),
        "final_return": last.data["values"]["eval/episode_reward"],
    }


def _directly(cache: Path, settings: Row) -> Row:
    request = {
        "environment": "ant",
        "engine": "native",
        "settings": settings,
        "seed": 0,
        "cache": os.fspath(cache),
        "checkpoint_every_steps": max(1, settings["num_timesteps"] // 10),
    }
    started = time.time()
    run = run_child("bench.ours.train_ppo", request, timeout_s=_TIMEOUT_S)
    return {
        "whole_s": run["evaluated_at"] - started,
        "training_s": run["evaluated_at"] - run["first_update_at"],
        "final_return": run["rewards"][-1][1],
    }


def _timestamp(moment: datetime | None) -> float:
    if moment is None:
        raise RuntimeError("The service sent an event without its time.")
    return moment.timestamp()


def _log(client: Client, job_id: str) -> str:
    return "\n".join(list(client.logs(job_id))[-20:])
