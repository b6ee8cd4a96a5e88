"""A job sent to a service of its own, twice: `python -m bench.ours.post_job FOLDER`.

Request: specification (of the job); mark (bench.measure.marks). The first job finds nothing compiled, the
second what the first left.
"""

import tempfile
import time
from pathlib import Path
from typing import Any

from bench.measure.child import answer
from bench.stack.embedded import running_stack


def work(request: dict[str, Any]) -> dict[str, Any]:
    """cold, warm: seconds from the submission to `mark`, the first evaluation that has it, and to `video`;
    None for what did not come."""
    from gaitway.client import Client

    with (
        tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder,
        running_stack(Path(folder)) as stack,
        Client(stack.url) as client,
    ):
        return {which: _followed(client, request) for which in ("cold", "warm")}


def _followed(client: Any, request: dict[str, Any]) -> dict[str, float | None]:
    """Raises RuntimeError if the job does not succeed."""
    found: dict[str, float | None] = {"mark": None, "video": None}
    mark, submitted = request["mark"], time.time()
    job = client.submit(request["specification"])
    for event in client.events(job.id):
        if event.time is None:
            continue
        seconds = event.time.timestamp() - submitted
        match event.kind:
            case "metrics" if event.data["values"].get(mark["metric"], -1e30) >= mark["least"]:
                found["mark"] = found["mark"] or seconds
            case "artifact" if event.data["role"] == "video":
                found["video"] = seconds
            case _:
                pass
    if not (ended := client.get(job.id)).succeeded:
        raise RuntimeError(f"Job {job.id} {ended.status}: {ended.message}")
    return found


if __name__ == "__main__":
    answer(work)
