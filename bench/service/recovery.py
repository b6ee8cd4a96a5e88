"""Times the resumption of a lost worker's job, the claim of a new one, and the start of the stack.

Also what a damaged newest checkpoint costs: one byte of it is flipped in SeaweedFS's volume, where it lies.
"""

import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import psutil

from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result, at_most
from bench.measure.statistics import spread
from bench.stack.embedded import Stack, running_stack
from bench.stack.waiting import until
from gaitway.client import Client
from gaitway.schema import ArtifactView
from gaitway.views import Event
from tests.faults.campaign.volumes import flip_byte

Row = dict[str, Any]
_ANT: Row = {
    "environment": "ant",
    "algorithm": {"kind": "ppo", "num_timesteps": 100_000_000},
    "checkpoints": {"every_steps": 20_000},
}


def measure(options: Options) -> Result:
    """Start an embedded stack repeatedly; then submit jobs to one with two workers, and kill a worker."""
    machine = this_machine()
    rounds = 1 if options.quick else 5
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        starts = [_start(Path(folder, "start")) for _ in range(1 + rounds)]
        data_dir = Path(folder, "stack")
        with running_stack(data_dir, workers=2) as stack:
            picked_up = [_pick_up_s(stack) for _ in range(2 * rounds)]
            lost = [_lost_worker(stack) for _ in range(rounds)]
            store = data_dir / "objects" / "data"
            lost_damaged = [_lost_worker(stack, damaged_in=store) for _ in range(rounds)]
            lent = [row for _ in range(rounds) for row in _lent_checkpoint(stack, store)]
    retried = [row["attempt_s"] for row in lost], [row["attempt_s"] for row in lost_damaged]
    resumed = [[row["attempt_s"] for row in lent if row["damaged"] == damaged] for damaged in (False, True)]
    return Result(
        name="recovery",
        title="Recovery",
        command="./run bench recovery",
        quick=options.quick,
        machine=machine,
        figures=[
            Figure.of(
                "from the kill of a worker to the job's return to the queue",
                spread([row["seen_s"] for row in lost]),
                "s",
                at_most(15),
            ),
            Figure.of(
                "from the kill of a worker to the next training step",
                spread([row["training_s"] for row in lost]),
                "s",
                at_most(30),
            ),
            Figure.of("from the submission to its worker's claim", spread(picked_up), "s", at_most(1)),
            *_costs("a retry after a kill", *retried),
            *_costs("`resume_from`", *resumed),
            Figure.of(
                "until `GET` of a damaged checkpoint is refused",
                spread([row["get_s"] for row in lent if row["damaged"]]),
                "s",
                at_most(15),
            ),
            Figure(name="the stack's first start", value=starts[0], unit="s", target=at_most(3)),
            Figure.of("a later start of the stack", spread(starts[1:]), "s", at_most(3)),
        ],
        rows=[*lost, *lost_damaged, *lent, *({"picked_up_s": seconds} for seconds in picked_up)],
        notes=[
            "A lost worker: one of the embedded stack's two workers is killed, with all its processes, while "
            "it trains an ant. When its lease of 14 s has run out, the other worker takes the next attempt; "
            "its new training process finds the compiled programs in the cache.",
            "A damaged checkpoint: one byte of the newest is flipped inside SeaweedFS's volume. The attempt "
            "that meets it resumes from the one before, which an event says. The time runs from the claim of "
            "that attempt to its first progress; the cost is the difference of the medians.",
        ],
    )


def _costs(how: str, whole: Sequence[float], damaged: Sequence[float]) -> Iterator[Figure]:
    """From an attempt's start to its training, and how much of that is due to a damaged newest checkpoint."""
    yield Figure.of(f"{how}: from the attempt's start to its training", spread(whole), "s")
    yield Figure.of(f"{how}: the same with a damaged newest checkpoint", spread(damaged), "s")
    cost_s = spread(damaged).median - spread(whole).median
    yield Figure(name=f"{how}: what the damage costs", value=cost_s, unit="s", target=at_most(15))


def _lost_worker(stack: Stack, damaged_in: Path | None = None) -> Row:
    """damaged_in: the folder of the object store, where the newest checkpoint is damaged after the kill."""
    with Client(stack.url) as client:
        until(lambda: len(list(client.workers())) >= 2)
        job = client.submit(**_ANT)
        until(lambda: len(client.checkpoints(job.id)) >= 2)
        # A worker reports its job only every few seconds.
        until(lambda: bool(_pids_with(client, job.id)))
        family = psutil.Process(_pids_with(client, job.id)[0])
        killed = time.time()
        for process in (family, *family.children(recursive=True)):
            with suppress(psutil.NoSuchProcess):
                process.send_signal(signal.SIGKILL)
        if damaged_in is not None:
            _damage(stack, _newest(client, job.id), damaged_in)
        later = [event for event in _until_it_trains(client, job.id, killed) if _moment(event) > killed]
        client.cancel(job.id)
        client.wait(job.id)
        attempt_s = _attempt_s(client, job.id, later[-1])
    seen = next(event for event in later if event.kind == "status" and event.data["status"] == "queued")
    _check_told(later, damaged_in is not None)
    return {
        "seen_s": _moment(seen) - killed,
        "training_s": _moment(later[-1]) - killed,
        "attempt_s": attempt_s,
        "damaged": damaged_in is not None,
    }


def _lent_checkpoint(stack: Stack, store: Path) -> Iterator[Row]:
    """Two jobs that resume from another's newest checkpoint, the second one after that was damaged."""
    with Client(stack.url) as client:
        until(lambda: len(list(client.workers())) >= 2)
        source = client.submit(**_ANT)
        until(lambda: len(client.checkpoints(source.id)) >= 2)
        client.cancel(source.id)
        client.wait(source.id)
        for damaged in (False, True):
            get_s = _damage(stack, _newest(client, source.id), store) if damaged else 0.0
            job = client.submit(**_ANT, resume_from={"job": source.id})
            events = list(_until_it_trains(client, job.id, 0.0))
            attempt_s = _attempt_s(client, job.id, events[-1])
            client.cancel(job.id)
            client.wait(job.id)
            _check_told(events, damaged)
            yield {"attempt_s": attempt_s, "damaged": damaged, "resumed": True, "get_s": get_s}


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


def _attempt_s(client: Client, job_id: str, progress: Event) -> float:
    """Seconds from the claim of its newest attempt to this event."""
    claimed = client.get(job_id).attempts[-1].started_at
    if claimed is None:
        raise RuntimeError(f"The service did not say when job {job_id} was claimed.")
    return _moment(progress) - claimed.timestamp()


def _pids_with(client: Client, job_id: str) -> list[int]:
    return [worker.pid for worker in client.workers() if worker.job == job_id and worker.pid is not None]


def _until_it_trains(client: Client, job_id: str, since: float) -> Iterator[Event]:
    for event in client.events(job_id):
        yield event
        # The beginning of a phase is told as progress, too.
        if event.kind == "progress" and event.data["phase"] == "training" and _moment(event) > since:
            return


def _moment(event: Event) -> float:
    return 0.0 if event.time is None else event.time.timestamp()


def _pick_up_s(stack: Stack) -> float:
    with Client(stack.url) as client:
        job = client.submit(environment="inverted_pendulum")
        until(lambda: bool(client.get(job.id).attempts))
        begun = client.get(job.id)
        client.cancel(job.id)
        client.wait(job.id)
    claimed = begun.attempts[0].started_at
    if claimed is None:
        raise RuntimeError(f"The service did not say when job {job.id} was claimed.")
    return (claimed - begun.created_at).total_seconds()


def _start(data_dir: Path) -> float:
    """Seconds from the command until it prints the service's address."""
    started = time.monotonic()
    command = [sys.executable, "-m", "gaitway.service.embedded.up", "--data", str(data_dir)]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True) as stack:
        line = "" if stack.stdout is None else stack.stdout.readline()
        ready_s = time.monotonic() - started
        stack.send_signal(signal.SIGINT)
        stack.wait(60)
    if re.search(r"http://", line) is None:
        raise RuntimeError(f"The stack did not start: {line}")
    return ready_s
