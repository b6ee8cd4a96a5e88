"""Makes the gallery's moving pictures: `python -m bench.service.gallery_pictures docs/pictures [NAME ...]`.

It trains each body on this machine, for some minutes, writes NAME-run.webp and prints what the first and the
last evaluation measured. Look at every picture before you commit it; docs/gallery.md says what was measured.
"""

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import av
from PIL import Image

from bench.stack.processes import running
from gaitway.client import Client
from gaitway.schema import JobView

_FPS = 15
_HEIGHT = 240


@dataclass(frozen=True)
class Shown:
    """A body that a job of docs/gallery.md trains, and the episodes of its policy that the picture shows.

    num_steps: of an episode, in environment steps, at most.
    """

    job: dict[str, Any]
    cameras: Sequence[str] = ("track",)
    width: int = 320  # Of each camera's picture.
    seconds: float = 8
    num_steps: int = 1000
    num_episodes: int = 1
    # Random actions on the left: a balanced pole hardly moves, and they show that it could fall.
    beside_random: bool = False


def _over_a_grid(**grid: Any) -> dict[str, Any]:
    return {"kind": "q_learning", "state_discretizer": {"kind": "disk_position_grid", **grid}}


SHOWN = {
    "inverted_pendulum": Shown({"environment": "inverted_pendulum"}, width=160, beside_random=True),
    # It stands still when it has reached its target, so an episode of the picture takes 1.5 s.
    "reacher": Shown(
        {
            "environment": "reacher",
            "algorithm": {"kind": "ppo", "num_timesteps": 1_200_000, "episode_length": 50},
        },
        seconds=9,
        num_steps=75,
        num_episodes=6,
    ),
    "brittle_star_undirected": Shown(
        {
            "environment": "brittle_star_undirected",
            "algorithm": _over_a_grid(x=[-1.5, 1.5], y=[-1.5, 1.5], cells=[3, 3]),
        },
        seconds=12,
    ),
    "brittle_star_light_escape": Shown(
        {
            "environment": "brittle_star_light_escape",
            "algorithm": _over_a_grid(x=[-10, 10], y=[-5, 5], cells=[4, 1]),
        },
        # Its ground has no marks by which one could see in a camera that goes with it how far it goes.
        cameras=("track", "top_camera"),
        width=240,
        seconds=20,
    ),
}


def main() -> None:
    """Train and film each body that is named, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(SHOWN)}")
    arguments = parser.parse_args()
    names = arguments.names or list(SHOWN)
    if unknown := [name for name in names if name not in SHOWN]:
        parser.error(f"There is no picture {unknown[0]!r}; there are {', '.join(SHOWN)}.")
    with (
        tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder,
        running(Path(folder, "stack"), workers=1) as parts,
        Client(parts.url) as client,
    ):
        for name in names:
            frames = _frames(client, name, SHOWN[name], Path(folder))
            _keep(frames, arguments.folder / f"{name}-run.webp")


def _frames(client: Client, name: str, shown: Shown, folder: Path) -> Sequence[Image.Image]:
    trained = _ended(client, {**shown.job, "name": name, "video": None})
    _print_outcome(client, trained)
    environment = trained.spec["environment"]
    policy = {"kind": "checkpoint", "job": trained.id}
    rollout = {
        "kind": "rollout",
        "environment": environment,
        "num_steps": shown.num_steps,
        "video": {
            "cameras": list(shown.cameras),
            "width": shown.width,
            "height": _HEIGHT,
            "fps": _FPS,
            "seconds": shown.seconds,
        },
    }
    if not shown.beside_random:
        return _filmed(client, {**rollout, "policy": policy, "num_episodes": shown.num_episodes}, folder)
    # As many episodes as fill the time, because they end with a fall.
    left = _filmed(client, {**rollout, "policy": {"kind": "random"}, "num_episodes": 100}, folder)
    right = _filmed(client, {**rollout, "policy": policy, "num_episodes": shown.num_episodes}, folder)
    return [_beside(*pair) for pair in zip(left, right, strict=True)]


def _ended(client: Client, spec: dict[str, Any]) -> JobView:
    """Raises RuntimeError unless the job succeeds."""
    job = client.wait(client.submit(spec).id)
    if not job.succeeded:
        raise RuntimeError(f"{job.id} {job.status}: {job.message}")
    return job


def _print_outcome(client: Client, job: JobView) -> None:
    measured = [row for row in client.metrics(job.id) if "eval/episode_reward" in row.values]
    for row in (*measured[:1], *measured[1:][-1:]):
        after = row.time - job.started_at if row.time and job.started_at else timedelta()
        print(f"{job.name}, {row.step:,} steps, {after.total_seconds():.0f} s after its start:")
        for metric, value in sorted(row.values.items()):
            if metric.startswith("eval/"):
                said = "not finite" if value is None else f"{value:.4g}"
                print(f"  {metric.removeprefix('eval/')} {said}", flush=True)


def _filmed(client: Client, rollout: dict[str, Any], folder: Path) -> Sequence[Image.Image]:
    job = _ended(client, rollout)
    with av.open(str(client.video(job.id, folder / f"{job.id}.mp4"))) as film:
        return [frame.to_image() for frame in film.decode(video=0)]


def _beside(left: Image.Image, right: Image.Image) -> Image.Image:
    gap = 4
    both = Image.new("RGB", (left.width + gap + right.width, left.height), "white")
    both.paste(left)
    both.paste(right, (left.width + gap, 0))
    return both


def _keep(frames: Sequence[Image.Image], path: Path) -> None:
    following, each_ms = frames[1:], round(1000 / _FPS)
    frames[0].save(
        path, save_all=True, append_images=following, duration=each_ms, loop=0, quality=55, method=6
    )
    print(f"{path}: {len(frames)} frames, {path.stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
