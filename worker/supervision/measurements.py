"""The measurements of a job, over all of its attempts, as a file: written once, when an attempt ends.

The feed holds them; nothing is kept in memory while the job runs, and a part of the feed at a time here.
"""

import hashlib
import json
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

from core.jobs import feeds
from core.jobs.attempts import Claim
from core.jobs.job import Artifact
from core.jobs.metrics import Block, Measurement, Newest
from core.retry import CalledOff
from core.storage import keys

NAME = "metrics.jsonl"


def store_metrics(
    claim: Claim, file: IO[bytes], path: Path, keep_checkpoints: int, called_off: Callable[[], bool]
) -> bool:
    """Write each row as a line of JSON, store the file and record it; returns whether there are rows.

    A row that a later attempt measured again is left out. file: empty or of an earlier try, at `path`.
    Raises CalledOff; OSError where there is no room; the errors of `feeds.read_metrics`; LeaseLost.
    """
    newest = Newest(_blocks(claim, called_off))
    file.seek(0)
    file.truncate()
    digest, size = hashlib.sha256(), 0
    for block in _blocks(claim, called_off):
        for row in newest.of(block).rows():
            line = _line(row)
            file.write(line)
            digest.update(line)
            size += len(line)
    file.flush()
    if not size:
        return False
    artifact = Artifact(
        name=NAME,
        role="metrics",
        media_type="application/jsonl",
        size=size,
        sha256=digest.hexdigest(),
        key=keys.artifact(claim.job_id, claim.number, digest.hexdigest(), NAME),
    )
    claim.objects.put_file(artifact.key, path, media_type=artifact.media_type)
    claim.publish((artifact,), keep_checkpoints)
    return True


def _blocks(claim: Claim, called_off: Callable[[], bool]) -> Iterator[Block]:
    for block, _ in feeds.read_metrics(claim.job_id, store=claim.store, objects=claim.objects):
        if called_off():
            raise CalledOff
        yield block


def _line(row: Measurement) -> bytes:
    time = datetime.fromtimestamp(row.time, UTC).isoformat()
    return json.dumps({"time": time, "step": row.step, "values": row.values}, sort_keys=True).encode() + b"\n"
