"""Requests at a fixed rate, whether or not the answers keep up (an open loop)."""

import asyncio
import time
from collections.abc import Sequence
from typing import Any

import aiohttp
import httpx


async def post_at_rate(
    url: str, body: dict[str, Any], *, per_second: float, count: int
) -> tuple[list[float], list[str]]:
    """Seconds that each of `count` submissions took, and the ids of the jobs.

    The time runs from the moment a request was due, not from when it was sent: a stall is counted
    for every request it delays. Raises an ExceptionGroup of aiohttp's errors for refusals.
    """
    seconds, jobs = [0.0] * count, [""] * count

    async def one(number: int, due: float) -> None:
        async with client.post(f"{url}/jobs", json=body) as response:
            jobs[number] = (await response.json())["id"]
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
            under_way.create_task(one(number, due))
    return seconds, jobs


async def remove(url: str, jobs: Sequence[str]) -> None:
    """Cancel and delete jobs that no worker has taken."""
    gate = asyncio.Semaphore(8)
    async with httpx.AsyncClient(base_url=url, timeout=60, trust_env=False) as client:

        async def one(job: str) -> None:
            async with gate:
                (await client.post(f"/jobs/{job}/cancel")).raise_for_status()
                (await client.delete(f"/jobs/{job}")).raise_for_status()

        await asyncio.gather(*(one(job) for job in jobs))
