"""dm_control's ant learns to run through a corridor of platforms with gaps between them.

Start the service with `./run up`, and then this: `.venv/bin/python examples/ant_in_gaps.py`.
"""

from pathlib import Path
from typing import Any

from gaitway import Client

JOB: dict[str, Any] = {
    "kind": "train",
    "name": "an ant in gaps",
    "environment": {
        "id": "corridor",
        "options": {"walker": "ant", "arena": "gaps", "gap_length": [0.05, 0.2], "num_next_obstacles": 2},
    },
    # A setting that is left out takes the value tuned for this body and the worker's device: on a CPU 3 M
    # steps, five minutes on two cores, after which it runs at 1.5 m/s and more but falls often; a GPU: 30 M.
    "algorithm": {"kind": "ppo"},
    "video": {"cameras": ["track", "walker/sideon"], "seconds": 10},
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
        main(service, JOB, Path("ant_in_gaps"))
