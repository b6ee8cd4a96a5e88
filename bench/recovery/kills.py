"""A worker that is killed while it trains, a damaged newest checkpoint, a claim, and the stack's start.

One of two workers is killed with all its processes; when its lease has run out, the other one takes the next
attempt, and finds the compiled programs in its cache. A checkpoint is damaged by one byte that is flipped
where it lies, in SeaweedFS's volume; the attempt that meets it resumes from the one before.
"""

import argparse
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import httpx
import psutil

from bench.stack import Stack, running_stack, until, up_command
from bench.summary import Figure, middle
from gaitway.client import Client
from gaitway.schema import ArtifactView
from gaitway.views import Event
from tests.faults.campaign.volumes import flip_byte

_ANT: dict[str, Any] = {
    "environment": "ant",
    "algorithm": {"kind": "ppo", "num_timesteps": 100_000_000},
    "checkpoints": {"every_steps": 20_000},
}


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    """On embedded stacks of their own."""
    rounds = range(1 if arguments.quick else 5)
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        starts = [_start_s(Path(folder, "start")) for _ in (0, *rounds)]
        yield Figure("the stack's first start", starts[0], "s", at_most=3)
        yield middle("a later start of the stack", starts[1:], "s", at_most=3)
        data_dir = Path(folder, "stack")
        store = data_dir / "objects" / "data"
        with running_stack(data_dir, workers=2) as stack, Client(stack.url) as client:
            claims = [_claim_s(client) for _ in (*rounds, *rounds)]
            yield middle("from the submission to its worker's claim", claims, "s", at_most=1)
            lost = [_lost_worker(stack, client, None) for _ in rounds]
            damaged = [_lost_worker(stack, client, store) for _ in rounds]
            seen, trains = [one.seen_s for one in lost], [one.trains_s for one in lost]
            yield middle("from the kill of a worker to the job's return to the queue", seen, "s", at_most=15)
            yield middle("from the kill of a worker to the next training step", trains, "s", at_most=30)
            yield from _costs("a retry", [one.attempt_s for one in lost], [one.attempt_s for one in damaged])
            lent = [_source_checkpoint(stack, client, store) for _ in rounds]
            yield from _costs("`resume_from`", [one.whole_s for one in lent], [one.damaged_s for one in lent])
            refused = [one.refused_s for one in lent]
            yield middle("until `GET` of a damaged checkpoint is refused", refused, "s", at_most=15)


def _costs(how: str, whole: Sequence[float], damaged: Sequence[float]) -> Iterator[Figure]:
    """From an attempt's claim to its training, and how much of that is due to a damaged checkpoint."""
    yield middle(f"{how}: from its claim to its training", whole, "s")
    yield middle(f"{how}: the same with a damaged newest checkpoint", damaged, "s")
    yield Figure(f"{how}: what the damage costs", median(damaged) - median(whole), "s", at_most=15)


@dataclass(frozen=True)
class _Lost:
    """Seconds from a kill to the queue and to training, and from the new attempt's claim to training."""

    seen_s: float
    trains_s: float
    attempt_s: float


def _lost_worker(stack: Stack, client: Client, damaged_in: Path | None) -> _Lost:
    """damaged_in: the folder of the object store, where the newest checkpoint is damaged after the kill."""
    until(lambda: len(list(client.workers())) >= 2)
    job = client.submit(**_ANT)
    until(lambda: len(client.checkpoints(job.id)) >= 2)
    until(lambda: bool(_pids_with(client, job.id)))  # A worker reports its job only every few seconds.
    family = psutil.Process(_pids_with(client, job.id)[0])
    killed = time.time()
    for process in (family, *family.children(recursive=True)):
        with suppress(psutil.NoSuchProcess):
            process.send_signal(signal.SIGKILL)
    if damaged_in is not None:
        _damage(stack, _newest(client, job.id), damaged_in)
    later = [event for event in _until_it_trains(client, job.id, killed) if _moment(event) > killed]
    attempt_s = _ended_attempt_s(client, job.id, later[-1])
    _check_told(later, damaged_in is not None)
    seen = next(event for event in later if event.kind == "status" and event.data["status"] == "queued")
    return _Lost(_moment(seen) - killed, _moment(later[-1]) - killed, attempt_s)


@dataclass(frozen=True)
class _Lent:
    """Seconds from the claim of a job that resumes from another's checkpoint to its training."""

    whole_s: float
    damaged_s: float
    refused_s: float


def _source_checkpoint(stack: Stack, client: Client, store: Path) -> _Lent:
    """Two jobs that resume from another's newest checkpoint, the second one after that was damaged."""
    until(lambda: len(list(client.workers())) >= 2)
    source = client.submit(**_ANT)
    until(lambda: len(client.checkpoints(source.id)) >= 2)
    client.cancel(source.id)
    client.wait(source.id)
    whole_s = _resumed_s(client, source.id, damaged=False)
    refused_s = _damage(stack, _newest(client, source.id), store)
    return _Lent(whole_s, _resumed_s(client, source.id, damaged=True), refused_s)


def _resumed_s(client: Client, source: str, *, damaged: bool) -> float:
    job = client.submit(**_ANT, resume_from={"job": source})
    events = list(_until_it_trains(client, job.id, 0.0))
    _check_told(events, damaged)
    return _ended_attempt_s(client, job.id, events[-1])


def _newest(client: Client, job_id: str) -> ArtifactView:
    return max(client.checkpoints(job_id), key=lambda checkpoint: checkpoint.step or 0)


def _damage(stack: Stack, checkpoint: ArtifactView, store: Path) -> float:
    """Flip a byte of it where it lies; returns the seconds until the API says so."""
    with httpx.Client(base_url=stack.url, timeout=60, trust_env=False) as http:
        if flip_byte(store, http.get(checkpoint.href).raise_for_status().content) == 0:
            raise RuntimeError(f"{checkpoint.name} was not found in the volumes of {store}.")
        asked = time.monotonic()
        answer = http.get(checkpoint.href)
        if answer.status_code != 404 or answer.json()["type"] != "/problems/object-damaged":
            raise RuntimeError(f"A damaged {checkpoint.name} is answered with {answer.status_code}.")
        return time.monotonic() - asked


def _check_told(events: Sequence[Event], damaged: bool) -> None:
    notes = [event.data["text"] for event in events if event.kind == "note"]
    if damaged != any("is damaged" in note for note in notes):
        raise RuntimeError(f"The job's events say of its checkpoint: {notes}")


def _ended_attempt_s(client: Client, job_id: str, progress: Event) -> float:
    """Cancel the job; seconds from the claim of its newest attempt to this event."""
    client.cancel(job_id)
    claimed = client.wait(job_id).attempts[-1].started_at
    if claimed is None:
        raise RuntimeError(f"The service did not say when job {job_id} was claimed.")
    return _moment(progress) - claimed.timestamp()


def _pids_with(client: Client, job_id: str) -> list[int]:
    return [worker.pid for worker in client.workers() if job_id in worker.jobs and worker.pid is not None]


def _until_it_trains(client: Client, job_id: str, since: float) -> Iterator[Event]:
    for event in client.events(job_id):
        yield event
        # The beginning of a phase is told as progress, too.
        if event.kind == "progress" and event.data["phase"] == "training" and _moment(event) > since:
            return


def _moment(event: Event) -> float:
    return 0.0 if event.time is None else event.time.timestamp()


def _claim_s(client: Client) -> float:
    job = client.submit(environment="inverted_pendulum")
    until(lambda: bool(client.get(job.id).attempts))
    client.cancel(job.id)
    begun = client.wait(job.id)
    claimed = begun.attempts[0].started_at
    if claimed is None:
        raise RuntimeError(f"The service did not say when job {job.id} was claimed.")
    return (claimed - begun.created_at).total_seconds()


def _start_s(data_dir: Path) -> float:
    """Seconds from the command until it prints the service's address."""
    began = time.monotonic()
    with subprocess.Popen(
        up_command(data_dir), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True
    ) as stack:
        line = "" if stack.stdout is None else stack.stdout.readline()
        ready_s = time.monotonic() - began
        stack.send_signal(signal.SIGINT)
        stack.wait(60)
    if "http://" not in line:
        raise RuntimeError(f"The stack did not start: {line}")
    return ready_s
