"""A rodent of 67 joints learns to run: 30 M steps on a GPU, 3 M on a CPU, 20 minutes at the least.

Start the service with `./run up`, and then this: `.venv/bin/python examples/rodent_run.py`.
"""

from pathlib import Path
from typing import Any

from gaitway import Client

JOB: dict[str, Any] = {
    "kind": "train",
    "name": "a rodent runs",
    "environment": "rodent",
    # A setting that is left out, the budget too, takes the value tuned for this body and the worker's device.
    "algorithm": {"kind": "ppo"},
    "video": {"camera": "track", "seconds": 10},
}


def main(client: Client, job: dict[str, Any], folder: Path) -> None:
    """Train, and bring the video, the policy and a report with the curves into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    ended = client.wait(client.submit(job).id)
    print(f"{ended.status}: {ended.message or ended.reason}")
    client.video(ended.id, folder / "video.mp4")
    client.download(ended.id, "policy", folder)
    client.share(ended.id, folder / "report.html")


if __name__ == "__main__":
    with Client() as service:
        main(service, JOB, Path("rodent_run"))
