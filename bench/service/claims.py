"""Claims among 10,000 waiting jobs of 50 users by 64 workers, on a PostgreSQL of its own with the embedded
stack's settings, on this machine's disk, with fsync.

The time of a claim is from asking until its worker knows which job it has: the choice, and its commit, which
does not wait for the disk. The end of the job before is apart. Each worker is a process that is connected,
and claims at random times: as if jobs took a minute on average, which makes one claim a second, and as if
they took 2 s, thirty a second. So many processes share this machine's cores with PostgreSQL; a worker alone
says what a claim costs: its time, and the processor's time in the worker and in its server process.
"""

import argparse
import random
import tempfile
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import closing
from datetime import timedelta
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import psutil
from sqlalchemy import text

from bench.summary import Figure, percentile
from core.adapters.postgres import schema
from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.jobs.attempts import Claim, claim_turn, new_secret
from core.jobs.job import Job, new_job_id
from core.jobs.queue import queue_names
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.reasons import Reason
from core.retry import retry_while_unavailable
from gaitway.service.embedded.postgres import Postgres
from tests.in_memory import MemoryObjectStore

_LEASE = timedelta(seconds=60)
# How long a job takes on average, and for how long claims are counted.
_PACES = ((60.0, 300.0), (2.0, 60.0))
# Within this time each worker makes its first claim.
_BEGIN_S = 10.0
_USERS, _PROJECTS = 50, 10


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    waiting, workers, rounds, paces = (
        (500, 8, 20, [(2.0, 3.0)]) if arguments.quick else (10_000, 64, 500, _PACES)
    )
    with (
        tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder,
        Postgres(Path(folder, "postgres")) as server,
    ):
        engine = connect_postgres(server.url, pool_size=8)
        schema.upgrade(engine)
        with ThreadPoolExecutor(8) as pool:
            list(pool.map(partial(_queue, PostgresJobStore(engine)), range(waiting)))
        engine.dispose()
        yield from _alone(server.url, workers, rounds)
        for job_s, seconds in paces:
            with ProcessPoolExecutor(workers, get_context("fork")) as processes:
                of_all = list(processes.map(partial(_work, server.url, job_s, seconds), range(workers)))
            # A first one connects, and PostgreSQL plans its statements.
            first = [claims[0] for claims in of_all if claims]
            later = [claim for claims in of_all for claim in claims[1:]]
            name = f"claim among {waiting:,} waiting, {workers} workers, {len(later) / seconds:.0f}/s"
            yield Figure(f"{name}, median", 1000 * percentile(later, 50), "ms")
            yield Figure(f"{name}, 99th percentile", 1000 * percentile(later, 99), "ms", at_most=5)
            yield Figure(f"{name}, the first of a process, median", 1000 * percentile(first, 50), "ms")


def _queue(store: PostgresJobStore, number: int) -> None:
    user = number % _USERS
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant"})
    now = store.now()
    project = f"p{user % _PROJECTS}"
    store.add(Job(id=new_job_id(now), spec=spec, created_at=now, owner=f"u{user}", project=project))


def _alone(url: str, workers: int, rounds: int) -> Iterator[Figure]:
    """One process that claims for all of them, one after another, while as many jobs run."""
    engine = connect_postgres(url, pool_size=1)
    with closing(PostgresJobStore(engine)) as store:
        with engine.connect() as connection:
            backend = psutil.Process(connection.execute(text("SELECT pg_backend_pid()")).scalar_one())
        held = deque(_claim(store, number) for number in range(workers))
        took, own_s, server_s = list[float](), 0.0, 0.0
        for number in range(rounds):
            _end(held.popleft())
            began, own_before, server_before = time.perf_counter(), time.process_time(), _cpu_s(backend)
            held.append(_claim(store, number))
            took.append(time.perf_counter() - began)
            own_s += time.process_time() - own_before
            server_s += _cpu_s(backend) - server_before
        for claim in held:
            _end(claim)
    yield Figure("claim of a worker alone, median", 1000 * percentile(took, 50), "ms")
    yield Figure("claim of a worker alone, 99th percentile", 1000 * percentile(took, 99), "ms")
    yield Figure("the same: processor's time in the worker", 1000 * own_s / rounds, "ms")
    yield Figure("the same: processor's time in PostgreSQL", 1000 * server_s / rounds, "ms")


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return times.user + times.system


def _claim(store: JobStore, number: int) -> Claim | None:
    claim = partial(
        claim_turn,
        queue_names("gpu:0"),
        f"host:gpu:{number}",
        store=store,
        objects=MemoryObjectStore(),
        lease=_LEASE,
        secret=new_secret(),
    )
    return retry_while_unavailable(claim)


def _end(held: Claim | None) -> None:
    if held is not None:
        held.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "Everything asked for is done.")


def _work(url: str, job_s: float, seconds: float, number: int) -> Sequence[float]:
    """How long each claim took, in seconds."""
    chance, claims = random.Random(number), list[float]()
    with closing(PostgresJobStore(connect_postgres(url, pool_size=1))) as store:
        until = time.monotonic() + _BEGIN_S + seconds
        time.sleep(chance.uniform(0, _BEGIN_S))
        while time.monotonic() < until:
            began = time.perf_counter()
            claim = _claim(store, number)
            claims.append(time.perf_counter() - began)
            time.sleep(min(chance.expovariate(1 / job_s), max(0.0, until - time.monotonic())))
            _end(claim)
    return claims
