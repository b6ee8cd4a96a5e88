"""Listings, claims, submissions and lease renewals among a million jobs, called one after another."""

import argparse
import gc
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import psycopg

from bench.summary import Figure, percentile
from core.adapters.postgres import schema
from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.jobs.job import Job, new_job_id
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.store import JobQuery, Whose
from gaitway.service.embedded.postgres import Postgres

_LEASE = timedelta(seconds=15)
# Ended jobs of each kind, environment and status, a second apart.
_FILL = """
INSERT INTO jobs (id, version, kind, environment, name, labels, spec, status, reason, created_at, finished_at,
                  num_attempts, owner, project)
SELECT lpad(to_hex(1700000000000 + i::bigint * 31000), 12, '0') || '-' || lpad(to_hex(i), 10, '0'), 4,
       CASE WHEN i % 5 = 0 THEN 'rollout' ELSE 'train' END,
       (ARRAY['ant', 'humanoid', 'hopper', 'rodent', 'walker2d'])[1 + i % 5],
       CASE WHEN i % 3 = 0 THEN 'sweep ' || i % 1000 END,
       jsonb_build_object('project', 'p' || i % 50, 'user', 'u' || i % 7),
       CASE WHEN i % 5 = 0
            THEN '{"kind": "rollout", "environment": {"id": "ant"}, "policy": {"kind": "random"}}'
            ELSE '{"kind": "train", "environment": {"id": "ant"}, "seed": ' || i % 10 || '}' END,
       CASE WHEN i % 20 = 0 THEN 'failed' WHEN i % 31 = 0 THEN 'cancelled' ELSE 'succeeded' END,
       CASE WHEN i % 20 = 0 THEN 'diverged' WHEN i % 31 = 0 THEN 'user_cancelled' ELSE 'completed' END,
       now() - interval '1 second' * (:count - i), now() - interval '1 second' * (:count - i), 1,
       'u' || i % 7, 'p' || i % 50
FROM generate_series(1, :count) AS i
"""
_FILL_ATTEMPTS = """
INSERT INTO attempts (job_id, number, token, worker, device, engine, started_at, ended_at, reason)
SELECT id, 1, '1-00', 'host:cpu', 'cpu', 'native', created_at, finished_at, reason FROM jobs
"""
_FILL_ARTIFACTS = """
INSERT INTO artifacts (job_id, name, position, role, media_type, size, sha256, key, step)
SELECT id, files.name, 1, 'checkpoint', 'application/octet-stream', 1000000, repeat('0', 64),
       'jobs/' || id || '/attempts/1/0000000000000000/' || files.name, 100
FROM jobs, (VALUES ('checkpoint-100.msgpack'), ('video.mp4'), ('metrics.jsonl')) AS files (name)
"""
_QUERIES = {
    "no filter": JobQuery(),
    "status=failed": JobQuery(status=JobStatus.FAILED),
    "kind=rollout": JobQuery(kind="rollout"),
    "environment=rodent": JobQuery(environment="rodent"),
    "a common label": JobQuery(labels={"user": "u3"}),
    "two labels (none)": JobQuery(labels={"user": "u3", "project": "nobody's"}),
    "a name": JobQuery(name="sweep 333"),
    "status and environment (none)": JobQuery(status=JobStatus.FAILED, environment="rodent"),
    "status, kind and label (none)": JobQuery(
        status=JobStatus.CANCELLED, kind="rollout", labels={"user": "u9"}
    ),
    "all at once": JobQuery(
        status=JobStatus.SUCCEEDED, kind="train", environment="rodent", labels={"user": "u3"}
    ),
}
_LAB = ("p1", "p2", "p3")
# With accounts: two listings, one's own and what others have.
_QUERIES_OF_A_MEMBER = {
    "three projects, one's own first": JobQuery(whose=Whose(projects=_LAB, first="u3")),
    "an owner": JobQuery(whose=Whose(owner="u3")),
    "an owner without any (none)": JobQuery(whose=Whose(projects=_LAB, owner="nobody")),
    "a project without any, somebody first (none)": JobQuery(whose=Whose(projects=("empty",), first="u9")),
    "three projects and a status": JobQuery(whose=Whose(projects=_LAB, first="u3"), status=JobStatus.FAILED),
}


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    """On a PostgreSQL of its own with the embedded stack's settings, on this machine's disk, with fsync."""
    num_ended, num_queued = (20_000, 500) if arguments.quick else (1_000_000, 10_000)
    rounds = 20 if arguments.quick else 200
    with (
        tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder,
        Postgres(Path(folder, "postgres")) as server,
    ):
        engine = connect_postgres(server.url)
        schema.upgrade(engine)
        _fill(server.url, num_ended)
        store = PostgresJobStore(engine)
        gc.collect()
        gc.freeze()  # As the API does.
        listings = {name: _each(store.list, [query] * rounds) for name, query in _QUERIES.items()}
        worst = max(listings, key=lambda name: percentile(listings[name], 99))
        yield _p99(f"`GET /jobs` among {num_ended:,}, worst filter ({worst})", listings[worst], 30)
        listings = {name: _each(store.list, [query] * rounds) for name, query in _QUERIES_OF_A_MEMBER.items()}
        worst = max(listings, key=lambda name: percentile(listings[name], 99))
        yield _p99(f"a member's `GET /jobs` among {num_ended:,}, worst filter ({worst})", listings[worst])
        yield _p99("a deep page by cursor", _pages(store, rounds), 30)
        queued = [_queued(store) for _ in range(num_queued)]
        submissions = _each(store.add, queued)
        claims = _each(lambda job: _claim(store, job), [store.get(job.id) for job in queued[: 5 * rounds]])
        held = [job.claimed("worker", store.now(), "00") for job in queued[: 5 * rounds]]
        renewals = _each(lambda job: store.renew(job.id, job.token, _LEASE), held)
        looks = _each(lambda _: (store.expired(), store.waiting(), store.undispatched()), range(10))
        yield _p99(f"claim among {num_queued:,} queued", claims, 10)
        yield _p99("submission", submissions)
        yield _p99("renewal of a lease", renewals)
        yield _p99("the reconciler's three queries of a look", looks)
        store.close()


def _fill(url: str, count: int) -> None:
    """Insert this number of ended jobs, on a connection without the service's time limits."""
    with psycopg.connect(url, autocommit=True) as connection:
        for statement in (_FILL.replace(":count", str(count)), _FILL_ATTEMPTS, _FILL_ARTIFACTS):
            connection.execute(statement)
        connection.execute("VACUUM ANALYZE")


def _queued(store: PostgresJobStore) -> Job:
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant"})
    now = store.now()
    return Job(id=new_job_id(now), spec=spec, created_at=now)


def _claim(store: PostgresJobStore, job: Job) -> None:
    store.save(job.claimed("worker", job.created_at, "00"), lease=_LEASE)


def _pages(store: PostgresJobStore, count: int) -> list[float]:
    cursor, seconds = None, list[float]()
    for _ in range(count):
        started = time.perf_counter()
        cursor = store.list(JobQuery(kind="train"), cursor=cursor, limit=200).next_cursor
        seconds.append(time.perf_counter() - started)
    return seconds


def _each(call: Callable[[Any], Any], items: Sequence[Any]) -> list[float]:
    seconds: list[float] = []
    for item in items:
        started = time.perf_counter()
        call(item)
        seconds.append(time.perf_counter() - started)
    return seconds


def _p99(name: str, seconds: Sequence[float], at_most: float | None = None) -> Figure:
    return Figure(f"{name}, 99th percentile", 1000 * percentile(seconds, 99), "ms", at_most=at_most)
