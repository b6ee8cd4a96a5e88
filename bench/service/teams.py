"""What docs/teams.md promises: room by preemption, many jobs at once, a preview of retention, quotas.

On the embedded servers, one API process and one worker; the ten thousand jobs have ended.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import psycopg

from bench.service.sorting import fill
from bench.stack import running_parts, until
from bench.summary import Figure, percentile
from gaitway.client import Client

_JOBS = 10_000
_AT_ONCE = 200
_RULES = {"checkpoints": 1, "videos_days": 30, "replays_days": 30, "failed_days": 30, "cancelled_days": 30}
_LOW = {
    "environment": "inverted_pendulum",
    "algorithm": {
        "num_timesteps": 10**9,
        "num_envs": 64,
        "num_evals": 0,
        "policy_hidden_layer_sizes": [16],
        "value_hidden_layer_sizes": [16],
    },
    "physics": "native",
    "video": None,
    "priority": "low",
}
_URGENT = {
    "kind": "rollout",
    "policy": {"kind": "zero"},
    "environment": "inverted_pendulum",
    "num_steps": 10,
    "video": None,
    "priority": "high",
}
# For an accelerator that no worker here has: the jobs wait.
_WAITING = {"kind": "train", "environment": "ant", "resources": {"accelerator": "gpu"}}
# In one project, ended long ago; each with nine files, and a part of each feed.
_FILL_MORE = """
UPDATE jobs SET project = 'default', finished_at = finished_at - interval '100 days'
WHERE status IN ('succeeded', 'failed');
INSERT INTO artifacts (job_id, name, position, role, media_type, size, sha256, key, step)
SELECT jobs.id, role || place, place, role, 'text/plain', 1000, '', jobs.id || '/' || place, place
FROM jobs CROSS JOIN unnest(ARRAY['checkpoint', 'checkpoint', 'checkpoint', 'checkpoint', 'video', 'poster',
    'replay', 'scene', 'policy']) WITH ORDINALITY AS files (role, place);
INSERT INTO chunks (job_id, channel, first, last, key, size, sha256)
SELECT jobs.id, channel, 1, 100, jobs.id || channel, 1000, ''
FROM jobs CROSS JOIN unnest(ARRAY['events', 'logs']) AS channels (channel)
"""


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    quick = arguments.quick
    count, rounds, at_once = (500, 1, 20) if quick else (_JOBS, 9, _AT_ONCE)
    with (
        running_parts(workers=1) as parts,
        Client(parts.url) as client,
        httpx.Client(base_url=parts.url, timeout=60, trust_env=False) as http,
    ):
        with psycopg.connect(parts.environment["GAITWAY_DATABASE_URL"], autocommit=True) as connection:
            fill(connection, count)
            for statement in _FILL_MORE.strip().split(";\n"):
                connection.execute(statement.encode())
            connection.execute("VACUUM ANALYZE")
        preview = "/projects/default/retention/preview"
        took = _ms(lambda: http.post(preview, json=_RULES), rounds)
        name = f"preview of all rules of retention over {count:,} ended jobs, median"
        yield Figure(name, percentile(took, 50), "ms", at_most=500)
        yield from _room(client, 1 if quick else 3)
        yield from _many(client, at_once)
        yield from _quotas(http, count, 20 if quick else 200)


def _room(client: Client, rounds: int) -> Iterator[Figure]:
    """From the submission of an urgent job to its claim, while a training has the only worker."""
    low = client.submit(_LOW)
    took = list[float]()
    for _ in range(rounds):
        until(lambda: _is_training(client, low.id))
        urgent = client.wait(client.submit(_URGENT).id, timeout=120)
        assert urgent.started_at is not None  # noqa: S101
        took.append((urgent.started_at - urgent.created_at).total_seconds())
    client.cancel(low.id)
    client.wait(low.id, timeout=60)
    name = "an urgent job's submission to its claim, where a training makes room"
    yield Figure(name, percentile(took, 50), "s", low=min(took), high=max(took), at_most=15)


def _is_training(client: Client, job_id: str) -> bool:
    job = client.get(job_id)
    return job.status == "running" and job.progress.phase == "training"


def _many(client: Client, count: int) -> Iterator[Figure]:
    ids = [client.submit(_WAITING).id for _ in range(count)]
    for what, act in (("cancelled", client.cancel_all), ("deleted", client.delete_all)):
        began = time.perf_counter()
        outcomes = act(ids)
        seconds = time.perf_counter() - began
        assert {one.result for one in outcomes} == {what}  # noqa: S101
        yield Figure(f"{count} jobs {what} by one request", seconds, "s")


def _quotas(http: httpx.Client, count: int, rounds: int) -> Iterator[Figure]:
    """What a quota with all limits adds to a submission, and the list of quotas."""
    without = percentile(_ms(lambda: http.post("/jobs", json=_WAITING), rounds), 50)
    most = {"running": 10**6, "queued": 10**6, "gpu_hours": 1e6, "bytes": 10**15}
    http.put("/quotas/project/default", json=most).raise_for_status()
    limited = percentile(_ms(lambda: http.post("/jobs", json=_WAITING), rounds), 50)
    yield Figure(f"`POST /jobs` among {count:,} ended: what a quota adds, median", limited - without, "ms")
    listed = percentile(_ms(lambda: http.get("/quotas"), rounds), 50)
    yield Figure(f"`GET /quotas` of a project with {count:,} ended jobs, median", listed, "ms")


def _ms(ask: Callable[[], Any], rounds: int) -> list[float]:
    """Milliseconds of each answer, after a first one."""
    found = list[float]()
    for _ in range(rounds + 1):
        began = time.perf_counter()
        ask().raise_for_status()
        found.append(1000 * (time.perf_counter() - began))
    return found[1:]
