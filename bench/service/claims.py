"""Claims among 10,000 waiting jobs of 50 users by 64 workers, on a PostgreSQL of its own with the embedded
stack's settings, on this machine's disk, with fsync. Each worker is a process.

It asks, as if its job took 2 s on average, so that some thirty claims a second come at random times.
"""

import argparse
import random
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from datetime import timedelta
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from bench.summary import Figure, percentile
from core.adapters.postgres import schema
from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.jobs.attempts import claim_turn, new_secret
from core.jobs.job import Job, new_job_id
from core.jobs.queue import queue_names
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.reasons import Reason
from core.retry import retry_while_unavailable
from gaitway.service.embedded.postgres import Postgres
from tests.in_memory import MemoryObjectStore

_LEASE = timedelta(seconds=60)
_JOB_S = 2.0
# Within this time each worker makes its first claim.
_BEGIN_S = 10.0
_USERS, _PROJECTS = 50, 10


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    waiting, workers, seconds = (500, 8, 3.0) if arguments.quick else (10_000, 64, 60.0)
    with (
        tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder,
        Postgres(Path(folder, "postgres")) as server,
    ):
        engine = connect_postgres(server.url, pool_size=8)
        schema.upgrade(engine)
        with ThreadPoolExecutor(8) as pool:
            list(pool.map(partial(_queue, PostgresJobStore(engine)), range(waiting)))
        engine.dispose()
        with ProcessPoolExecutor(workers, get_context("fork")) as processes:
            numbers = processes.map(partial(_work, server.url, seconds), range(workers))
            claims = [claim for of_one in numbers for claim in of_one]
    name = f"claim among {waiting:,} waiting, {workers} workers, {len(claims) / seconds:.0f}/s"
    yield Figure(f"{name}, median", 1000 * percentile(claims, 50), "ms")
    yield Figure(f"{name}, 99th percentile", 1000 * percentile(claims, 99), "ms", at_most=5)


def _queue(store: PostgresJobStore, number: int) -> None:
    user = number % _USERS
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant"})
    now = store.now()
    project = f"p{user % _PROJECTS}"
    store.add(Job(id=new_job_id(now), spec=spec, created_at=now, owner=f"u{user}", project=project))


def _work(url: str, seconds: float, number: int) -> list[float]:
    """How long each claim took, in seconds."""
    store = PostgresJobStore(connect_postgres(url, pool_size=1))
    chance, objects, claims = random.Random(number), MemoryObjectStore(), list[float]()
    queues, held = queue_names("gpu:0"), None
    claim = partial(claim_turn, queues, f"host:gpu:{number}", store=store, objects=objects, lease=_LEASE)
    until = time.monotonic() + _BEGIN_S + seconds
    time.sleep(chance.uniform(0, _BEGIN_S))
    while time.monotonic() + (pause := chance.expovariate(1 / _JOB_S)) < until:
        time.sleep(pause)
        if held is not None:
            held.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "Everything asked for is done.")
        started = time.perf_counter()
        held = retry_while_unavailable(partial(claim, secret=new_secret()))
        claims.append(time.perf_counter() - started)
    store.close()
    return claims[1:]  # The first one connects, and builds its statements.
