"""The table of jobs over HTTP: 10,000 jobs sorted by each column, with and without folded sweeps."""

import argparse
import json
import time
from collections.abc import Iterator

import httpx
import psycopg

from bench.stack import running_parts
from bench.summary import Figure, percentile
from core.jobs.sorting import COLUMNS

_JOBS, _TRIALS = 10_000, 200  # Every second job is a trial, and a sweep has so many.
_METRICS = {"eval/episode_reward": 0.5, **{f"training/term_{number}": number / 7 for number in range(50)}}
_PROGRESS = {"step": 77, "total": 10**6, "steps_per_second": 0.25, "metrics": _METRICS}
_SPEC = {
    "kind": "train",
    "environment": {"id": "ant"},
    "algorithm": {"kind": "ppo"},
    "labels": {"note": "x" * 500},
}
# Ended jobs, each a second after the one before, whose numbers are shuffled.
_FILL = """
INSERT INTO jobs (id, version, kind, environment, name, labels, spec, status, reason, created_at, started_at,
                  finished_at, num_attempts, device, engine, owner, project, progress)
SELECT lpad(to_hex(1700000000000 + i * 1000::bigint), 12, '0') || '-' || lpad(to_hex(i), 10, '0'), 4, 'train',
       (ARRAY['ant', 'humanoid', 'hopper', 'rodent', 'walker2d'])[1 + i %% 5], 'run ' || i * 7919 %% 10007,
       jsonb_build_object('arm', 'a' || i * 31 %% 97), %(spec)s,
       CASE WHEN i %% 20 = 0 THEN 'failed' ELSE 'succeeded' END, 'completed',
       now() - interval '1 s' * i, now() - interval '1 s' * i, now() + interval '1 s' * (i * 7919 %% 10007),
       1, 'gpu:' || i * 7919 %% 8, 'native', 'u' || i %% 7, 'p' || i %% 5,
       replace(replace(replace(%(progress)s, '77', (i * 7919 %% 10007)::text), '0.25', (i * 31 %% 97)::text),
               '0.5', (i * 7919 %% 10007 / 8.0)::text)
FROM generate_series(1, %(jobs)s) AS i
"""
_FILL_MORE = """
INSERT INTO attempts (job_id, number, token, worker, device, engine, started_at, ended_at, reason)
SELECT id, 1, '1-00', 'host:cpu', device, engine, created_at, finished_at, reason
FROM jobs;
INSERT INTO sweeps (id, version, status, spec, created_at)
SELECT lpad(to_hex(i), 12, '0') || '-0000000000', 1, 'succeeded', '{}', now()
FROM generate_series(0, (SELECT count(*) FROM jobs) / 2 / %(trials)s) AS i;
INSERT INTO trials (sweep_id, number, job_id, outcome, created_at, document)
SELECT lpad(to_hex(place / 2 / %(trials)s), 12, '0') || '-0000000000', place / 2 %% %(trials)s,
       id, 'succeeded', now(), '{}'
FROM (SELECT id, row_number() OVER (ORDER BY id) AS place FROM jobs) AS numbered WHERE place %% 2 = 0;
"""


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    """On the embedded servers and one API process, one request after another, each with 25 jobs."""
    count, rounds = (1000, 3) if arguments.quick else (_JOBS, 20)
    with (
        running_parts() as parts,
        httpx.Client(base_url=parts.url, timeout=30, trust_env=False) as http,
    ):
        with psycopg.connect(parts.environment["GAITWAY_DATABASE_URL"], autocommit=True) as connection:
            fill(connection, count)
        for what, sweep in (("", ""), (" and folded sweeps", "folded")):
            found = {column: _ms(http, column, sweep, rounds) for column in (*COLUMNS, "label:arm")}
            worst = max(found, key=lambda column: percentile(found[column], 99))
            yield Figure(
                f"`GET /jobs` among {count:,}, sorted{what}, worst column ({worst}), 99th percentile",
                percentile(found[worst], 99),
                "ms",
                at_most=100,
            )
        newest = _ms(http, "", "folded", rounds)
        yield Figure(
            f"`GET /jobs` among {count:,} with folded sweeps, 99th percentile", percentile(newest, 99), "ms"
        )


def fill(connection: psycopg.Connection, count: int) -> None:
    """Add so many ended jobs, of which every second is a trial."""
    texts = {"spec": json.dumps(_SPEC), "progress": json.dumps(_PROGRESS)}
    connection.execute(_FILL, {**texts, "jobs": count})
    for statement in _FILL_MORE.strip().split(";\n"):
        connection.execute(statement.rstrip(";").encode(), {"trials": _TRIALS})
    connection.execute("VACUUM ANALYZE")


def _ms(http: httpx.Client, column: str, sweep: str, rounds: int) -> list[float]:
    """Milliseconds of first and second pages, in both orders."""
    found = list[float]()
    for number in range(rounds):
        order = {"sort": column, "order": ("asc", "desc")[number % 2]} if column else {}
        asked = {**order, **({"sweep": sweep} if sweep else {}), "limit": "25"}
        for _ in range(2):
            began = time.perf_counter()
            answer = http.get("/jobs", params=asked).raise_for_status()
            found.append(1000 * (time.perf_counter() - began))
            asked["cursor"] = answer.json()["next"]
    return found
