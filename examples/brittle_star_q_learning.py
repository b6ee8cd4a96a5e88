"""A table learns in a hundred episodes to steer a brittle star through its central pattern generator.

Start the service with `./run up`, and then this: `.venv/bin/python examples/brittle_star_q_learning.py`.
"""

from pathlib import Path
from typing import Any

from gaitway import Client

JOB: dict[str, Any] = {
    "kind": "train",
    "name": "steer a brittle star",
    "environment": "brittle_star",
    # Each arm chooses for itself with "state_discretizer": {"kind": "arm_role"} and
    # "action_set": {"kind": "arm_roles"}.
    "algorithm": {"kind": "q_learning"},
    "video": {"cameras": ["track", "top_camera"], "width": 480, "height": 360, "seconds": 20},
}
TABLE_AND_CURVE = ("q_table.png", "visits.png", "tables.npz", "episodes.png", "path.png")


def main(client: Client, job: dict[str, Any], folder: Path) -> None:
    """Train, and bring the video, the table and the curve into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    ended = client.wait(client.submit(job).id)
    print(f"{ended.status}: {ended.message or ended.reason}")
    client.video(ended.id, folder / "video.mp4")
    for name in TABLE_AND_CURVE:
        client.download(ended.id, name, folder)
    reached = [row.values.get("eval/episode_target_reached") for row in client.metrics(ended.id)]
    *_, last = (share for share in reached if share is not None)
    print(f"Targets reached in the last evaluation: {100 * last:.0f} %")


if __name__ == "__main__":
    with Client() as service:
        main(service, JOB, Path("brittle_star"))
