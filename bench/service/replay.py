"""Measures replays: the worker's time, their bytes, and how fast a browser without a GPU draws them."""

import os

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import hashlib
import time
from collections.abc import Mapping
from datetime import timedelta
from typing import Any

import mujoco
import numpy as np
from playwright.sync_api import Browser

from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result
from bench.measure.statistics import spread
from bench.service.page import settings_of
from bench.stack.browser import stack_and_browser
from bench.stack.processes import Parts
from core.adapters.wiring import job_store, object_store
from core.environments import catalog
from core.jobs.attempts import claim_attempt, new_secret
from core.jobs.job import Artifact, ArtifactRole, Job, new_job_id
from core.jobs.spec import JOB_SPEC
from core.physics.choose import engine_builder
from core.rendering.replay.replay import replay_of, scene_of
from core.rendering.timeline import Motion
from core.storage import keys

_BODIES = ("ant", "rodent", "brittle_star")
_WIDTH, _HEIGHT = 1280, 900
PICTURES = "() => Number(document.querySelector('canvas').dataset.pictures || 0)"


def measure(options: Options) -> Result:
    """Write an episode of each body under random actions, and play it in Chromium."""
    seconds = 1.0 if options.quick else 10.0
    rows: list[dict[str, Any]] = []
    figures: list[Figure] = []
    with stack_and_browser() as (parts, browser):
        for body in _BODIES:
            files, costs = _written(body, seconds, 1 if options.quick else 5)
            named: dict[str, tuple[ArtifactRole, bytes]] = {
                "scene.glb": ("scene", files[0]),
                "replay.bin": ("replay", files[1]),
            }
            job_id = published(parts, body, named)
            played = _played(browser, parts.url, job_id, seconds)
            sizes = {"scene_bytes": len(files[0]), "replay_bytes": len(files[1])}
            rows.append({"body": body, **sizes, **played})
            figures += _figures(rows[-1], costs, seconds)
    return Result(
        name="replay",
        title="Replays in the page",
        command="./run bench replay",
        quick=options.quick,
        machine=this_machine(),
        figures=figures,
        rows=rows,
        notes=[
            f"An episode of {seconds:g} s under random actions. Chromium without a window draws the page at "
            f"{_WIDTH}×{_HEIGHT} in software (SwiftShader) beside the service, on the same cores, without "
            "shadows; a slow machine gets fewer pixels after a while."
        ],
    )


def _figures(row: Mapping[str, Any], costs: Mapping[str, list[float]], seconds: float) -> list[Figure]:
    body = row["body"]
    return [
        Figure(name=f"{body}: the scene", value=row["scene_bytes"] / 1000, unit="kB"),
        Figure(name=f"{body}: {seconds:g} s of poses", value=row["replay_bytes"] / 1000, unit="kB"),
        Figure.of(f"{body}: the worker's time for the scene", spread(costs["scene_ms"]), "ms"),
        Figure.of(f"{body}: the worker's time for the poses", spread(costs["replay_ms"]), "ms"),
        Figure(name=f"{body}: from the address to the first picture", value=row["first_picture_s"], unit="s"),
        Figure(name=f"{body}: drawn in software", value=row["frames_per_s"], unit="frames/s"),
    ]


def _written(body: str, seconds: float, rounds: int) -> tuple[tuple[bytes, bytes], dict[str, list[float]]]:
    """The scene and the replay, and what they cost."""
    info, options = catalog.resolve(body, {})
    environment = catalog.make(info, options, engine_builder("native"))
    model, tracked = environment.model, environment.tracked_body
    motion = _motion(model, environment.dt, seconds)
    reward = np.zeros(len(motion.time) - 1)
    costs: dict[str, list[float]] = {"scene_ms": [], "replay_ms": []}
    scene = replay = b""
    for _ in range(rounds):
        began = time.perf_counter()
        scene = scene_of(model, motion.qpos[0], tracked)
        between = time.perf_counter()
        replay = replay_of(model, [motion], [reward], [{"duration_s": seconds, "terminated": False}], tracked)
        costs["scene_ms"].append(1000 * (between - began))
        costs["replay_ms"].append(1000 * (time.perf_counter() - between))
    return (scene, replay), costs


def _motion(model: mujoco.MjModel, dt: float, seconds: float) -> Motion:
    """What C MuJoCo makes of random actions."""
    data, generator = mujoco.MjData(model), np.random.default_rng(0)
    steps, substeps = round(seconds / dt), max(1, round(dt / model.opt.timestep))
    qpos = [data.qpos.copy()]
    for _ in range(steps):
        data.ctrl[:] = generator.uniform(-1, 1, model.nu) * np.minimum(
            1, np.abs(model.actuator_ctrlrange[:, 1])
        )
        mujoco.mj_step(model, data, substeps)
        qpos.append(data.qpos.copy())
    return Motion(dt * np.arange(steps + 1), np.array(qpos))


def published(parts: Parts, body: str, files: Mapping[str, tuple[ArtifactRole, bytes]]) -> str:
    """A job with these files; its id."""
    settings = settings_of(parts)
    store, objects = job_store(settings), object_store(settings)
    now = store.now()
    spec = JOB_SPEC.validate_python(
        {"kind": "train", "environment": body, "resources": {"accelerator": "gpu"}}
    )
    job = Job(id=new_job_id(now), spec=spec, created_at=now)
    store.add(job)
    lease = timedelta(seconds=50)
    claim = claim_attempt(job.id, 1, "bench", store=store, objects=objects, lease=lease, secret=new_secret())
    if claim is None:
        raise RuntimeError(f"Somebody else runs job {job.id}.")
    claim.start(device="gpu:0", engine="native", details={})
    for name, (role, content) in files.items():
        digest = hashlib.sha256(content).hexdigest()
        key = keys.artifact(job.id, 1, digest, name)
        objects.put(key, content)
        artifact = Artifact(
            name=name,
            role=role,
            media_type="application/octet-stream",
            size=len(content),
            sha256=digest,
            key=key,
            metadata={"can_run": True} if role == "simulation" else {},
        )
        claim.publish((artifact,), keep_checkpoints=5)
    return job.id


def _played(browser: Browser, url: str, job_id: str, seconds: float) -> dict[str, float]:
    """Seconds until a new reader sees the body, and pictures a second when it plays after that."""
    page = browser.new_page(viewport={"width": _WIDTH, "height": _HEIGHT}, reduced_motion="reduce")
    page.set_default_timeout(120_000)
    began = time.perf_counter()
    page.goto(f"{url}/#/jobs/{job_id}/replay?t=0")
    page.locator("canvas[data-pictures][data-shown]").wait_for()
    first = time.perf_counter() - began
    page.get_by_role("button", name="Play").click()
    page.wait_for_timeout(1000 * min(seconds, 6.0))  # Until it has found how much this machine can draw.
    before, since = page.evaluate(PICTURES), time.perf_counter()
    page.wait_for_timeout(1000 * min(seconds, 6.0))
    drawn = (page.evaluate(PICTURES) - before) / (time.perf_counter() - since)
    page.context.close()
    return {"first_picture_s": first, "frames_per_s": drawn}
