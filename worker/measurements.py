"""What a job has measured, over all of its attempts."""

import json

from core.jobs.store import JobStore


def measurements(store: JobStore, job_id: str) -> list[str]:
    """JSON documents of step, time and values; a later row for the same step in the place of an earlier."""
    feed = store.feed(job_id, "events", kind="metrics", limit=1_000_000)
    rows = {(e.data["step"], tuple(sorted(e.data["values"]))): e for e in feed}
    return [json.dumps({"time": e.time.isoformat(), **e.data}, sort_keys=True) for e in rows.values()]
