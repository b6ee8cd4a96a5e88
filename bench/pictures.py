"""Makes the pictures of docs/pictures: `python -m bench.pictures page|gallery|film docs/pictures [NAME ...]`.

`page` trains two ants, a pendulum and a robot here, for some minutes, and looks at them in Chromium.
`gallery` trains each body, writes NAME-run.webp and prints what the first and the last evaluation measured.
`film` writes the picture of one body from the file of a policy that was trained elsewhere: `--policy FILE`,
or of a clip that it follows, NAME-imitates.webp: `--clip FILE`.
Look at every picture before you commit it.
"""

import argparse
import hashlib
import io
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path
from typing import Any

import av
import jax
import mujoco
from PIL import Image
from playwright.sync_api import Browser, Page

from bench.children.train_imitation import canonical
from bench.stack import chromium, running_parts
from core.algorithms.policy_file import read_policy
from core.algorithms.ppo.policy import make_inference
from core.environments import catalog, trajectory
from core.environments.rollout import rollout
from core.jobs.spec import TrainSpec
from core.physics.choose import engine_builder
from core.rendering.request import RenderRequest
from gaitway.client import Client
from gaitway.schema import JobView
from worker.render.client import render

_EXAMPLES = Path(__file__).parents[1] / "examples"
_VIDEO = {"every_checkpoint": True, "seconds": 8, "width": 640, "height": 360}
_ANT: dict[str, Any] = {
    "environment": "ant",
    "checkpoints": {"every_steps": 300_000},
    "video": _VIDEO,
    "labels": {"project": "gaits"},
}


_SWEEP: dict[str, Any] = {
    "name": "learning rates",
    "method": "grid",
    "job": {"environment": "inverted_pendulum", "video": None, "algorithm": {"num_timesteps": 40_000}},
    "parameters": {"algorithm.learning_rate": {"low": 1e-4, "high": 1e-2, "log": True, "points": 4}},
}
_PART = {"accelerator": "gpu", "share_gpu": True}


_FPS = 15
_HEIGHT = 240
# Of a clip: the longest that its film is, and the picture's width.
_CLIP_S, _CLIP_WIDTH = 12.0, 320


@dataclass(frozen=True)
class Shown:
    """A body that a job of docs/gallery.md trains, and the episodes of its policy that the picture shows.

    num_steps: of an episode, in environment steps, at most. filmed: options of the environment in place of
    those of the training. seed: of the episodes that are filmed.
    """

    job: dict[str, Any]
    cameras: Sequence[str] = ("track",)
    width: int = 320  # Of each camera's picture.
    seconds: float = 8
    num_steps: int = 1000
    num_episodes: int = 1
    filmed: dict[str, Any] = field(default_factory=dict[str, Any])
    seed: int = 0
    # Random actions on the left: a balanced pole hardly moves, and they show that it could fall.
    beside_random: bool = False


def _over_a_grid(**grid: Any) -> dict[str, Any]:
    return {"kind": "q_learning", "state_discretizer": {"kind": "disk_position_grid", **grid}}


# New every two seconds, so that the picture shows several.
_COMMAND = {"kind": "velocity", "forward": [0.3, 1.0], "left": [-0.2, 0.2], "every_s": 2.0, "standing": 0.0}

SHOWN = {
    "go1": Shown({"environment": "go1"}, seconds=6, filmed={"command": _COMMAND}),
    "go1-rough": Shown(
        {"environment": {"id": "go1", "options": {"task": "rough"}}},
        seconds=7,
        filmed={
            "terrain": {"kinds": ["stairs_up"], "levels": [5, 5]},
            "command": _COMMAND | {"forward": [0.5, 0.6], "left": [0.0, 0.0], "turn": [0.0, 0.0]},
            "events": [],
        },
        seed=2,
    ),
    "go1-get-up": Shown(
        {"environment": {"id": "go1", "options": {"task": "get_up"}}},
        seconds=8,
        num_steps=100,
        num_episodes=4,
        seed=1,
    ),
    "g1": Shown({"environment": "g1"}, width=240, seconds=6, filmed={"command": _COMMAND}),
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
    """Make the page's pictures, or those of each body that is named, or of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("page", "gallery", "film"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"gallery: of {', '.join(SHOWN)}")
    parser.add_argument("--policy", type=Path, help="film: a checkpoint's policy")
    parser.add_argument("--clip", type=Path, help="film: of a body that follows clips")
    parser.add_argument("--episodes", type=int, default=1, metavar="N", help="film: how many")
    arguments = parser.parse_args()
    if arguments.what == "film":
        if len(arguments.names) != 1 or arguments.policy is None:
            parser.error("film takes one NAME and a --policy.")
        [name] = arguments.names
        shown = SHOWN.get(name) or Shown({"environment": name}, num_episodes=arguments.episodes)
        frames = _acted(shown, arguments.policy, arguments.clip)
        does = "run" if arguments.clip is None else "imitates"
        _keep_film(frames, arguments.folder / f"{name}-{does}.webp")
        return
    if unknown := [name for name in arguments.names if name not in SHOWN]:
        parser.error(f"There is no picture {unknown[0]!r}; there are {', '.join(SHOWN)}.")
    with running_parts(workers=1) as parts, Client(parts.url) as client:
        if arguments.what == "page":
            with chromium("--enable-unsafe-swiftshader") as browser:
                _take(browser, client, parts.url, arguments.folder)
        for name in arguments.names or (SHOWN if arguments.what == "gallery" else ()):
            frames = _frames(client, name, SHOWN[name])
            _keep_film(frames, arguments.folder / f"{name}-run.webp")


def _take(browser: Browser, client: Client, url: str, folder: Path) -> None:
    desk = browser.new_page(viewport={"width": 1280, "height": 900}, reduced_motion="reduce")
    walks = client.add_model(_EXAMPLES / "quadruped.xml").recipe_job
    # A worker that trains would not draw the body.
    _show(desk, f"{url}/#/submit?environment=ant")
    desk.get_by_role("img", name="ant, camera track").wait_for(timeout=120_000)
    _keep(desk, folder / "page-submit.webp")
    trained = [
        client.submit(
            {
                **_ANT,
                "name": f"ant, learning rate {rate:g}",
                "algorithm": {"num_timesteps": 1_200_000, "learning_rate": rate},
            }
        )
        for rate in (3e-4, 1e-3)
    ]
    for job in trained:
        client.wait(job.id)
    pendulum = client.submit({"environment": "inverted_pendulum", "name": "pendulum", "video": _VIDEO})
    client.wait(pendulum.id)
    robot = client.submit({**(walks or {}), "name": "quadruped"})
    client.wait(robot.id)
    _show(desk, f"{url}/#/jobs/{robot.id}/push")
    desk.get_by_text("Steer it with W A S D").wait_for(timeout=120_000)
    desk.get_by_role("button", name="Play").click()  # With reduced motion it waits.
    desk.locator(".stage").focus()
    desk.keyboard.down("w")
    desk.wait_for_timeout(8000)
    _keep(desk, folder / "page-drive.webp")
    desk.keyboard.up("w")
    client.wait_for_sweep(client.sweep(_SWEEP).id)
    shared = client.submit({"environment": "hopper", "name": "hopper, shares a GPU", "resources": _PART})
    running_job = client.submit({**_ANT, "name": "a longer run", "algorithm": {"num_timesteps": 10**7}})
    waiting = client.submit({"environment": "hopper", "name": "hopper, waits for the worker"})
    for event in client.events(running_job.id):
        if event.kind == "artifact" and event.data["role"] == "checkpoint":
            break
    ids = ",".join(job.id for job in trained)
    views = {
        "page": "#/jobs",
        "page-job": f"#/jobs/{trained[1].id}",
        "page-compare": f"#/compare?ids={ids}",
        "page-models": "#/models",
        "page-workers": "#/workers",
    }
    for name, view in views.items():
        _show(desk, f"{url}/{view}")
        _keep(desk, folder / f"{name}.webp")
    phone = browser.new_page(
        viewport={"width": 380, "height": 820},
        reduced_motion="reduce",
        color_scheme="dark",
        device_scale_factor=2,
    )
    _show(phone, f"{url}/#/jobs/{trained[1].id}")
    _keep(phone, folder / "page-phone.webp", most=2)
    for job in (shared, waiting, running_job):
        client.cancel(job.id)


def _show(page: Page, address: str) -> None:
    """Until nothing is loaded any more and each film shows its first picture."""
    page.goto("about:blank")
    page.goto(address)
    page.locator("main h1").wait_for()
    page.wait_for_function("() => !document.querySelector('main').innerText.includes('Loading')")
    page.wait_for_function(
        "() => [...document.querySelectorAll('video')].every((one) => one.readyState >= 2)"
    )
    page.wait_for_timeout(4000)  # Streams stay open: that the last curve is drawn shows in nothing.


def _keep(page: Page, path: Path, most: float = 1.2) -> None:
    """most: what is lower than this many times the width is cut off."""
    picture = Image.open(io.BytesIO(page.screenshot(full_page=True)))
    height = min(picture.height, round(most * picture.width))
    picture.crop((0, 0, picture.width, height)).save(path, quality=80, method=6)


def _frames(client: Client, name: str, shown: Shown) -> Sequence[Image.Image]:
    trained = _ended(client, {**shown.job, "name": name, "video": None})
    _print_outcome(client, trained)
    environment = trained.spec["environment"]
    environment = {**environment, "options": {**environment["options"], **shown.filmed}}
    policy = {"kind": "checkpoint", "job": trained.id}
    rollout = {
        "kind": "rollout",
        "environment": environment,
        "num_steps": shown.num_steps,
        "seed": shown.seed,
        "video": {
            "cameras": list(shown.cameras),
            "width": shown.width,
            "height": _HEIGHT,
            "fps": _FPS,
            "seconds": shown.seconds,
        },
    }
    if not shown.beside_random:
        return _filmed(client, {**rollout, "policy": policy, "num_episodes": shown.num_episodes})
    # As many episodes as fill the time, because they end with a fall.
    left = _filmed(client, {**rollout, "policy": {"kind": "random"}, "num_episodes": 100})
    right = _filmed(client, {**rollout, "policy": policy, "num_episodes": shown.num_episodes})
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


def _acted(shown: Shown, policy: Path, clip: Path | None) -> Sequence[Image.Image]:
    """Pictures of a rollout in this process, under the policy of a file. clip: a file of clips, of which the
    body follows one from its beginning to its end; None: it does what the job trains."""
    asked = TrainSpec.model_validate(shown.job).environment
    options, clips = {**asked.options, **shown.filmed}, dict[str, Path]()
    seconds, width = (shown.seconds, shown.width) if clip is None else (_CLIP_S, _CLIP_WIDTH)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        if clip is not None:
            file_id = f"sha256:{hashlib.sha256(clip.read_bytes()).hexdigest()}"
            [clips[file_id]] = canonical([clip], place)
            reference = {"clips": [{"file": file_id}], "random_phase": 0.0}
            options = {"task": "imitate", "reference": reference}
        info, resolved = catalog.resolve(asked.id, options)
        environment = catalog.make(info, resolved, engine_builder("native"), clips=clips)
        act = make_inference(read_policy(policy.read_bytes()))
        steps = min(shown.num_steps, round(seconds / environment.dt))
        key = jax.random.PRNGKey(shown.seed)
        acted = rollout(environment, act, key=key, num_steps=steps, num_episodes=shown.num_episodes)
        trajectory.save(place / "acted.npz", acted)
        mujoco.mj_saveModel(environment.model, str(place / "model.mjb"), None)
        request = RenderRequest(
            trajectory=place / "acted.npz",
            model=place / "model.mjb",
            tracked_body=environment.tracked_body,
            video=place / "film.mp4",
            poster=place / "film.png",
            cameras=list(shown.cameras),
            width=width,
            height=_HEIGHT,
            fps=_FPS,
            seconds=seconds,
        )
        render(request, timeout_s=600)
        return _images(request.video)


def _filmed(client: Client, rollout: dict[str, Any]) -> Sequence[Image.Image]:
    job = _ended(client, rollout)
    with tempfile.TemporaryDirectory() as folder:
        return _images(client.video(job.id, Path(folder, "film.mp4")))


def _images(video: Path) -> Sequence[Image.Image]:
    with av.open(str(video)) as film:
        return [frame.to_image() for frame in film.decode(video=0)]


def _beside(left: Image.Image, right: Image.Image) -> Image.Image:
    gap = 4
    both = Image.new("RGB", (left.width + gap + right.width, left.height), "white")
    both.paste(left)
    both.paste(right, (left.width + gap, 0))
    return both


def _keep_film(frames: Sequence[Image.Image], path: Path) -> None:
    following, each_ms = frames[1:], round(1000 / _FPS)
    frames[0].save(
        path, save_all=True, append_images=following, duration=each_ms, loop=0, quality=55, method=6
    )
    print(f"{path}: {len(frames)} frames, {path.stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
