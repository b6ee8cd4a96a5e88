"""An attempt's own folder. It is removed with the attempt or, if that was killed, by the next one here.

The ends of attempts that a worker could not record in PostgreSQL before it shut down wait on its disk. The
next worker on that disk records them. If it comes too late, the job was taken back as a lost worker's.
"""

import os
import shutil
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

import structlog
from pydantic import ValidationError

from core.documents import Stored
from core.errors import Conflict, NotFound
from core.jobs.attempts import Claim
from core.jobs.job import Job
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.reasons import Reason
from core.retry import pause
from core.storage.objects import ObjectStore
from worker.host.locks import remove_lock, take_lock
from worker.supervision.outcome import Outcome

# The folder of all attempts' spools, in GAITWAY_DATA_DIR.
SPOOLS = "spool"
_PAUSE_S = 0.01
_LOCK, _PRIVATE = ".lock", ".private"
log = structlog.get_logger()
# Their folder in GAITWAY_DATA_DIR.
LEFT = "left"


def private(path: Path) -> Path:
    """The folder beside a spool for what its training process, which may be taken over, must not reach."""
    return path.with_name(path.name + _PRIVATE)


@contextmanager
def spool(path: Path) -> Generator[Path]:
    """The folder, empty at first, and locked for as long as this process lives: workers may share a disk."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = path.with_name(path.name + _LOCK)
    while (descriptor := take_lock(lock)) is None:
        pause(_PAUSE_S)  # Another worker is checking whether somebody holds it.
    try:
        path.mkdir(exist_ok=True)
        private(path).mkdir(exist_ok=True)
        yield path
    finally:
        _remove(path, lock, descriptor)


def remove_left_over(folder: Path) -> None:
    """Remove the spools in this folder that no process holds: their containers were killed."""
    names = {file.name.removesuffix(_LOCK).removesuffix(_PRIVATE) for file in folder.glob("*")}
    for name in names:
        lock = folder / (name + _LOCK)
        with suppress(OSError):  # The next worker tries again.
            if (descriptor := take_lock(lock)) is not None:
                _remove(folder / name, lock, descriptor)


def _remove(path: Path, lock: Path, descriptor: int) -> None:
    for one in (path, private(path)):
        shutil.rmtree(one, ignore_errors=True)
    remove_lock(lock, descriptor)  # Last: until then nobody else touches the folder.


class LeftAttempt(Stored):
    """An attempt and its outcome, as they are written to disk."""

    job_id: str
    number: int
    token: str
    status: JobStatus | None
    reason: Reason
    message: str


def end(claim: Claim, outcome: Outcome) -> Job:
    """Record how the attempt ended. Raises LeaseLost, NotFound, RecordsUnavailable."""
    if outcome.status is None:
        return claim.give_back(outcome.reason, outcome.message)
    return claim.end(outcome.status, outcome.reason, outcome.message)


def leave(data_dir: Path, claim: Claim, outcome: Outcome) -> None:
    """Keep the outcome for the next worker on this disk. Raises OSError."""
    folder = data_dir / LEFT
    folder.mkdir(parents=True, exist_ok=True)
    left = LeftAttempt(
        job_id=claim.job_id,
        number=claim.number,
        token=claim.token,
        status=outcome.status,
        reason=outcome.reason,
        message=outcome.message,
    )
    part = folder / f"{claim.job_id}.{claim.number}.part"
    part.write_text(left.model_dump_json())
    os.replace(part, part.with_suffix(".json"))


def record_left(data_dir: Path, store: JobStore, objects: ObjectStore) -> None:
    """Record every outcome that is kept here. Raises RecordsUnavailable; what was not recorded stays."""
    for path in sorted((data_dir / LEFT).glob("*.json")):
        try:
            left = LeftAttempt.model_validate_json(path.read_bytes())
            claim = Claim(left.job_id, left.number, left.token, store, objects)
            job = end(claim, Outcome(left.status, left.reason, left.message))
            log.info("left_attempt_told", job_id=job.id, status=job.status, reason=left.reason)
        except FileNotFoundError:  # Another worker on this disk was faster.
            continue
        except (Conflict, NotFound, ValidationError) as error:  # The job has continued without it.
            log.warning("left_attempt_dropped", file=path.name, error=str(error))
        path.unlink(missing_ok=True)
