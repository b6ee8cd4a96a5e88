"""Submissions at a fixed rate, the memory of the API, and the way to a training process's first line."""

import argparse
import asyncio
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import aiohttp

from bench.stack import Stack, running_stack
from bench.summary import Figure, middle, percentile
from gaitway.client import Client

_PER_SECOND = 100.0
# For an accelerator that no worker here has: the jobs wait.
_JOB: dict[str, Any] = {"kind": "train", "environment": "ant", "resources": {"accelerator": "gpu"}}


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    """Each is one durable transaction in PostgreSQL, and its message is in the queue, before its answer."""
    count = 100 if arguments.quick else 1000
    with (
        tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder,
        running_stack(Path(folder)) as stack,
        Client(stack.url) as client,
    ):
        starts = [_first_line_s(client) for _ in range(1 if arguments.quick else 5)]
        yield middle("POST to the training process's first line", starts, "s", at_most=1)
        asyncio.run(post_at_rate(stack.url, _JOB, per_second=20, count=20))
        yield from _submitted(stack, count)
        resident = max(one.memory_info().rss / 1e6 for one in stack.api_processes())
        yield Figure("API process, resident", resident, "MB", at_most=120)


def _submitted(stack: Stack, count: int) -> Iterator[Figure]:
    before = stack.cpu_s()
    seconds = asyncio.run(post_at_rate(stack.url, _JOB, per_second=_PER_SECOND, count=count))
    used = {name: 1000 * (after - before.get(name, 0.0)) / count for name, after in stack.cpu_s().items()}
    name = f"`POST /jobs`, {_PER_SECOND:g} a second"
    yield Figure(f"{name}, 50th percentile", 1000 * percentile(seconds, 50), "ms")
    yield Figure(f"{name}, 99th percentile", 1000 * percentile(seconds, 99), "ms", at_most=25)
    for part in ("api", "postgres", "valkey-server"):
        yield Figure(f"processor time of a submission, {part}", used.get(part, 0.0), "ms")


def _first_line_s(client: Client) -> float:
    """Seconds from a submission to the event `process`, which comes before the process imports anything."""
    submitted = time.time()
    job = client.submit(environment="ant", video={"seconds": 0.1, "width": 16, "height": 16})
    for event in client.events(job.id):
        if event.kind == "phase" and event.data["name"] == "process" and event.time is not None:
            client.cancel(job.id)
            client.wait(job.id, timeout=300)
            return event.time.timestamp() - submitted
    raise RuntimeError(f"Job {job.id} never had a training process.")


async def post_at_rate(url: str, body: dict[str, Any], *, per_second: float, count: int) -> list[float]:
    """Seconds that each of `count` submissions took, in an open loop.

    The time runs from the moment at which a request was due, not from when it was sent: a stall is counted
    for every request that it delays. Raises an ExceptionGroup of aiohttp's errors for refusals.
    """
    seconds = [0.0] * count

    async def post(number: int, due: float) -> None:
        async with client.post(f"{url}/jobs", json=body) as response:
            await response.read()
        seconds[number] = time.perf_counter() - due

    connections = aiohttp.TCPConnector(limit=100, keepalive_timeout=30)
    timeout = aiohttp.ClientTimeout(total=60)
    async with (
        aiohttp.ClientSession(connector=connections, timeout=timeout, raise_for_status=True) as client,
        asyncio.TaskGroup() as under_way,
    ):
        began = time.perf_counter() + 0.1
        for number in range(count):
            due = began + number / per_second
            await asyncio.sleep(due - time.perf_counter())
            # Created late: sixty thousand waiting tasks kept the garbage collector busy for 0.1 s at a time.
            under_way.create_task(post(number, due))
    return seconds
