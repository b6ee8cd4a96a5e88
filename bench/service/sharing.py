"""Small trainings that share a GPU, against one that has a GPU alone.

The first of its kind has a GPU alone, and its memory is measured. Then two such share a GPU. A third has the
other GPU alone at the same time, or, on a machine with one GPU, that one before them.
"""

import argparse
import subprocess
import sys
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from typing import Any

import httpx

from bench.stack import Parts, running_parts, until
from bench.summary import Figure
from worker.host.device import visible_gpus

_SETTINGS = {"kind": "ppo", "num_envs": 512, "num_evals": 2}
_FIRST_STEPS, _LASTS_S = 20_000_000, 60.0
_SEATS, _TIMEOUT_S = 2, 900.0  # On each GPU.


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    """With the embedded servers, and a fleet on the first GPUs, at most two. Prints who ran where, when."""
    gpus = min(2, len(visible_gpus()))
    if gpus == 0:
        yield Figure("sharing: two of a kind on one GPU", None, missing="needs a GPU")
        return
    with (
        running_parts() as parts,
        _fleet(parts, gpus),
        httpx.Client(base_url=parts.url, timeout=30, trust_env=False) as http,
    ):
        until(lambda: _num_ready(http) == _SEATS * gpus, _TIMEOUT_S)
        (first,) = _run(http, [_job(_FIRST_STEPS, share_gpu=True)])
        steps = int(_rate(first) * (5.0 if arguments.quick else _LASTS_S))
        sharing, alone = [_job(steps, share_gpu=True)] * 2, [_job(steps, gpus=1)]
        others = _run(http, alone) if gpus == 1 else []
        one, two, *beside = _run(http, sharing if gpus == 1 else sharing + alone)
    both = _overlap_s(one, two) / max(_seconds(one), _seconds(two))
    yield Figure("sharing: memory of one training at most", _attempt(first)["peak_bytes"] / 1e9, "GB")
    yield Figure("sharing: part of the GPU's memory for each", 100 * _attempt(one)["gpu_part"], "%")
    is_shared = _where(one) == _where(two) and all(_where(one) != _where(other) for other in beside)
    yield Figure("sharing: both on one GPU, and no other job there", float(is_shared), at_least=1)
    yield Figure("sharing: of their time both ran", 100 * both, "%")
    [lone] = others or beside
    yield Figure("sharing: one alone", _rate(lone) / 1e3, "thousand steps/s")
    together = _rate(one) + _rate(two)
    yield Figure("sharing: the two together", together / 1e3, "thousand steps/s")
    yield Figure("sharing: two that share, against two in turn", together / _rate(lone), "times", at_least=1)


@contextmanager
def _fleet(parts: Parts, gpus: int) -> Generator[None]:
    variables = {**parts.environment, "GAITWAY_POOL": f"gpu:0-{gpus - 1}"}
    fleet = subprocess.Popen([sys.executable, "-m", "worker.fleet"], env=variables, stdout=sys.stderr)
    try:
        yield
    finally:
        fleet.terminate()
        fleet.wait()


def _job(steps: int, **resources: Any) -> dict[str, Any]:
    settings = {**_SETTINGS, "num_timesteps": steps}
    return {
        "kind": "train",
        "environment": "ant",
        "algorithm": settings,
        "video": None,
        "resources": resources,
    }


def _num_ready(http: httpx.Client) -> int:
    return sum(worker["state"] == "ready" for worker in http.get("/workers").json()["items"])


def _run(http: httpx.Client, jobs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Submit them, wait for their ends, and print where each ran. Raises RuntimeError if one fails."""
    links = [http.post("/jobs", json=job).raise_for_status().json()["links"]["self"] for job in jobs]

    def ended() -> list[dict[str, Any]]:
        return [job for link in links if (job := http.get(link).json())["finished_at"]]

    until(lambda: len(ended()) == len(jobs), _TIMEOUT_S)
    found = ended()
    for job in found:
        if job["status"] != "succeeded":
            raise RuntimeError(f"The job {job['id']} has {job['status']}: {job['message']}")
        attempt = _attempt(job)
        part = attempt["gpu_part"]
        print(
            f"{job['id']} on {attempt['details']['gpus']}, "
            f"{'alone' if part is None else f'with {part:.0%} of its memory'}, "
            f"from {attempt['started_at']} to {attempt['ended_at']}: {_rate(job):,.0f} steps/s",
            file=sys.stderr,
        )
    return found


def _attempt(job: dict[str, Any]) -> dict[str, Any]:
    return job["attempts"][-1]


def _rate(job: dict[str, Any]) -> float:
    return job["progress"]["steps_per_second"]


def _where(job: dict[str, Any]) -> str:
    return _attempt(job)["details"]["gpus"]


def _times(job: dict[str, Any]) -> tuple[float, float]:
    attempt = _attempt(job)
    began, ended = (datetime.fromisoformat(attempt[name]) for name in ("started_at", "ended_at"))
    return began.timestamp(), ended.timestamp()


def _seconds(job: dict[str, Any]) -> float:
    began, ended = _times(job)
    return ended - began


def _overlap_s(one: dict[str, Any], two: dict[str, Any]) -> float:
    times = _times(one), _times(two)
    return max(0.0, min(ended for _, ended in times) - max(began for began, _ in times))
