"""One party of bench.service.load as a process: `post`, `look`, `follow` or `work`, its request's `part`."""

import asyncio
import json
import random
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import datetime, timedelta
from typing import Any

import httpx
from rq import Queue
from rq.serializers import JSONSerializer

from bench.child import answer
from bench.service.submissions import post_at_rate
from core.adapters.wiring import connect_redis, job_store, object_store
from core.configuration import read
from core.errors import Conflict
from core.jobs.attempts import claim_attempt, new_secret
from core.jobs.job import Progress
from core.jobs.queue import queue_names
from core.jobs.status import JobStatus
from core.jobs.store import Entry, JobStore
from core.reasons import Reason
from core.settings import WorkerSettings
from core.storage.objects import ObjectStore

# For an accelerator that no worker of the service has: only this bench's workers take them.
JOB = {"kind": "train", "environment": "ant", "resources": {"accelerator": "gpu"}}
DEVICE = "gpu:0"
_LEASE = timedelta(seconds=15)
_FILTERS = ({}, {"status": "queued"}, {"status": "running"}, {"environment": "ant"}, {"label": "user:u1"})
_LISTS_PER_SECOND = 5.0

Answer = dict[str, Any]


def post(request: Answer) -> Answer:
    """Submissions at a fixed rate. seconds: of each."""
    time.sleep(request["after_s"])
    count = round(request["per_second"] * request["seconds"])
    rate = request["per_second"]
    return {"seconds": asyncio.run(post_at_rate(request["url"], JOB, per_second=rate, count=count))}


def look(request: Answer) -> Answer:
    """Listings with changing filters. seconds: of each."""
    seconds: list[float] = []
    time.sleep(request["after_s"])
    until = time.monotonic() + request["seconds"]
    with httpx.Client(base_url=request["url"], timeout=30, trust_env=False) as client:
        while (began := time.monotonic()) < until:
            before = time.perf_counter()
            asked = _FILTERS[len(seconds) % len(_FILTERS)]
            client.get("/jobs", params=asked).raise_for_status()
            seconds.append(time.perf_counter() - before)
            time.sleep(max(0.0, began + 1 / _LISTS_PER_SECOND - time.monotonic()))
    return {"seconds": seconds}


def follow(request: Answer) -> Answer:
    """Readers that each follow one job after the other.

    delays: seconds from each entry's time to its arrival; gaps: entries that were missed or came twice;
    broken: streams that ended without the job's end.
    """
    return asyncio.run(_follow(request))


async def _follow(request: Answer) -> Answer:
    found: Answer = {"delays": [], "gaps": 0, "broken": 0}
    until = time.monotonic() + request["seconds"]
    limits = httpx.Limits(max_connections=request["readers"], max_keepalive_connections=request["readers"])
    async with httpx.AsyncClient(
        base_url=request["url"], timeout=httpx.Timeout(60), limits=limits, trust_env=False
    ) as client:

        async def read_on(number: int) -> None:
            for job in request["jobs"][number :: request["readers"]]:
                with suppress(TimeoutError):
                    async with asyncio.timeout(until - time.monotonic()):
                        await _read(client, job, found)
                if time.monotonic() >= until:
                    return

        await asyncio.gather(*(read_on(number) for number in range(request["readers"])))
    return found


async def _read(client: httpx.AsyncClient, job: str, found: Answer) -> None:
    expected, last = 1, ""
    try:
        async with client.stream("GET", f"/jobs/{job}/events") as answered:
            answered.raise_for_status()
            async for line in answered.aiter_lines():
                name, _, value = line.partition(": ")
                if name == "id":
                    found["gaps"] += int(value) != expected
                    expected = int(value) + 1
                elif name == "data":
                    said = json.loads(value)
                    last = said["data"].get("status", "")
                    # Entries from before the stream began do not measure it.
                    if expected > 2:
                        passed = time.time() - datetime.fromisoformat(said["time"]).timestamp()
                        found["delays"].append(passed)
    except httpx.HTTPError:
        found["broken"] += 1
    else:
        found["broken"] += last not in ("succeeded", "cancelled")


def work(request: Answer) -> Answer:
    """Workers as threads: they take jobs from RQ, claim them and end them without training.

    claims: seconds of each claim. training_s: how long a worker keeps a job.
    """
    settings = read(WorkerSettings)
    store, objects = job_store(settings), object_store(settings)
    with ThreadPoolExecutor(request["workers"]) as pool:
        parts = list(pool.map(lambda _: _work(request, settings, store, objects), range(request["workers"])))
    return {"claims": [seconds for part in parts for seconds in part]}


def _work(request: Answer, settings: WorkerSettings, store: JobStore, objects: ObjectStore) -> list[float]:
    done: list[float] = []
    until = time.monotonic() + request["seconds"]
    with connect_redis(settings.redis_url.get_secret_value()) as client:
        queues = [Queue(name, connection=client, serializer=JSONSerializer) for name in queue_names(DEVICE)]
        while time.monotonic() < until:
            taken = Queue.dequeue_any(queues, timeout=1, connection=client, serializer=JSONSerializer)
            if taken is None:
                continue
            message, _ = taken
            job_id, number = message.args
            message.delete(remove_from_queue=False)
            before = time.perf_counter()
            claim = claim_attempt(
                job_id, number, "bench", store=store, objects=objects, lease=_LEASE, secret=new_secret()
            )
            seconds = time.perf_counter() - before
            if claim is None:
                continue
            done.append(seconds)
            with suppress(Conflict):
                claim.start(device=DEVICE, engine="none", details={})
                _train(store, job_id, claim.token, request["training_s"])
                claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "Nothing was trained.")
    return done


def _train(store: JobStore, job_id: str, token: str, seconds: float) -> None:
    """Record what a short training reports: rows of metrics with progress, and heartbeats."""
    for step in range(1, 5):
        time.sleep(seconds / 4 * random.uniform(0.5, 1.5))
        store.renew(job_id, token, _LEASE)
        rows = [Entry(kind="metrics", time=store.now(), data={"step": step, "values": {"reward": 1.0}})]
        store.record(job_id, token, "events", rows, Progress(step=step, total=4), write_id=new_secret())


_PARTS = {"post": post, "look": look, "follow": follow, "work": work}

if __name__ == "__main__":
    answer(lambda request: _PARTS[request["part"]](request))
