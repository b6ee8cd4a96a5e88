"""The measurements of a job, over all of its attempts, as a file: written once, when an attempt ends.

The feed holds them; nothing is kept in memory while the job runs, and a page of the feed at a time here.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

from core.jobs import feeds
from core.jobs.attempts import Claim
from core.jobs.job import Artifact
from core.jobs.measured import Measured
from core.retry import CalledOff
from core.storage import keys

NAME = "metrics.jsonl"
# A row's step, and the names of its values.
Identity = tuple[int, tuple[str, ...]]


def store_metrics(
    claim: Claim, file: IO[bytes], path: Path, keep_checkpoints: int, called_off: Callable[[], bool]
) -> bool:
    """Write each row as a line of JSON, store the file and record it; returns whether there are rows.

    A row that a later attempt measured again is left out. file: empty or of an earlier try, at `path`.
    Raises CalledOff; OSError where there is no room; the errors of `feeds.read_metrics`; LeaseLost.
    """
    again = Counter[Identity]()
    if claim.number > 1:
        again.update(identity for identity, is_repeated in _identified(claim, called_off) if is_repeated)
    file.seek(0)
    file.truncate()
    digest, size = _write(file, claim, again, called_off)
    if not size:
        return False
    artifact = Artifact(
        name=NAME,
        role="metrics",
        media_type="application/jsonl",
        size=size,
        sha256=digest,
        key=keys.artifact(claim.job_id, claim.number, digest, NAME),
    )
    claim.objects.put_file(artifact.key, path, media_type=artifact.media_type)
    claim.publish((artifact,), keep_checkpoints)
    return True


def _write(
    file: IO[bytes], claim: Claim, again: Counter[Identity], called_off: Callable[[], bool]
) -> tuple[str, int]:
    """Write all rows but those that come again; the SHA-256 of the file, and its size."""
    digest, size = hashlib.sha256(), 0
    repeats = _Repeats()
    for row in _rows(claim, called_off):
        if again:
            identity, is_repeated = repeats.identify(row)
            if identity in again:
                again[identity] -= is_repeated
                if again[identity]:
                    continue
        line = _line(row)
        file.write(line)
        digest.update(line)
        size += len(line)
    file.flush()
    return digest.hexdigest(), size


class _Repeats:
    """Finds rows that may be measured again, because an attempt has resumed before them.

    Within an attempt steps do not fall. So only these have to be kept in mind, and not the whole run.
    """

    def __init__(self) -> None:
        self._highest = self._until = -1
        self._at_highest = set[tuple[str, ...]]()

    def identify(self, row: Measured) -> tuple[Identity, bool]:
        """The row's identity, and whether an earlier row may have the same one."""
        step, names = row.said.step, tuple(sorted(row.said.values))
        if step > self._highest:
            self._highest = step
            self._at_highest.clear()
        elif step < self._highest:
            self._until = max(self._until, self._highest)
        is_repeated = step <= self._until or names in self._at_highest
        if step == self._highest:
            self._at_highest.add(names)
        return (step, names), is_repeated


def _identified(claim: Claim, called_off: Callable[[], bool]) -> Iterator[tuple[Identity, bool]]:
    repeats = _Repeats()
    return (repeats.identify(row) for row in _rows(claim, called_off))


def _rows(claim: Claim, called_off: Callable[[], bool]) -> Iterator[Measured]:
    after, is_end = 0, False
    while not is_end:
        if called_off():
            raise CalledOff
        page = feeds.read_metrics(
            claim.job_id, after, feeds.METRICS_PAGE, store=claim.store, objects=claim.objects
        )
        yield from page.measured
        after, is_end = page.last, page.is_end


def _line(row: Measured) -> bytes:
    time = datetime.fromtimestamp(row.time, UTC).isoformat()
    said = {"time": time, "step": row.said.step, "values": row.said.values}
    return json.dumps(said, sort_keys=True).encode() + b"\n"
