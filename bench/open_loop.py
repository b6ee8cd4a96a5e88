"""Requests at a fixed rate, whether or not the answers keep up (an open loop)."""

import asyncio
import time
from collections.abc import Sequence
from typing import Any

import httpx


async def post_at_rate(
    url: str, body: dict[str, Any], *, per_second: float, count: int
) -> tuple[list[float], list[str]]:
    """Seconds that each of `count` submissions took, and the ids of the jobs.

    The time runs from the moment a request was due, not from when it was sent: a stall is counted
    for every request it delays. Raises httpx.HTTPStatusError for a refusal.
    """
    limits = httpx.Limits(max_connections=100, max_keepalive_connections=100)
    async with httpx.AsyncClient(base_url=url, timeout=30, limits=limits, trust_env=False) as client:
        began = time.perf_counter() + 0.1
        due = [began + number / per_second for number in range(count)]
        answers = await asyncio.gather(*(_post(client, body, moment) for moment in due))
    return [seconds for seconds, _ in answers], [job for _, job in answers]


async def _post(client: httpx.AsyncClient, body: dict[str, Any], due: float) -> tuple[float, str]:
    await asyncio.sleep(due - time.perf_counter())
    response = await client.post("/jobs", json=body)
    seconds = time.perf_counter() - due
    response.raise_for_status()
    return seconds, response.json()["id"]


async def remove(url: str, jobs: Sequence[str]) -> None:
    """Cancel and delete jobs that no worker has taken."""
    gate = asyncio.Semaphore(8)
    async with httpx.AsyncClient(base_url=url, timeout=60, trust_env=False) as client:

        async def one(job: str) -> None:
            async with gate:
                (await client.post(f"/jobs/{job}/cancel")).raise_for_status()
                (await client.delete(f"/jobs/{job}")).raise_for_status()

        await asyncio.gather(*(one(job) for job in jobs))
