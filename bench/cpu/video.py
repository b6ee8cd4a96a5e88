"""Measures how long a clip takes in software GL, and whether its memory grows with its length."""

import os

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import jax
import mujoco

from bench.measure.child import run_child
from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result, at_most
from bench.measure.statistics import alternate, ratios, spread
from core.environments import catalog, trajectory
from core.environments.rollout import random_policy, rollout
from core.physics.choose import engine_builder

_WIDTH, _HEIGHT, _FPS = 640, 480, 30

Run = dict[str, Any]


def measure(options: Options) -> Result:
    """Draw a short and a long clip of the same ant under random actions in turn, each in new processes."""
    machine = this_machine()
    short_s, long_s = (1.0, 2.0) if options.quick else (10.0, 60.0)
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as name:
        folder = Path(name)
        request = _stage(folder, long_s)
        clips = alternate(
            1 if options.quick else 3,
            short=partial(_clip, request, short_s),
            long=partial(_clip, request, long_s),
        )
    short, long = clips["short"], clips["long"]
    peaks = {name: [run["peak_mb"] for run in runs] for name, runs in clips.items()}
    return Result(
        name="video",
        title="Video in software GL, ant",
        command="./run bench video",
        quick=options.quick,
        machine=machine,
        figures=[
            Figure.of(f"a clip of {short_s:g} s", spread([run["wall_s"] for run in short]), "s", at_most(15)),
            Figure.of(f"a clip of {long_s:g} s", spread([run["wall_s"] for run in long]), "s"),
            Figure.of(
                "frames drawn and encoded", spread([r["frames"] / r["wall_s"] for r in long]), "frames/s"
            ),
            Figure.of(f"peak memory, {short_s:g} s", spread(peaks["short"]), "MB"),
            Figure.of(f"peak memory, {long_s:g} s", spread(peaks["long"]), "MB"),
            Figure.of("peak memory, long ÷ short", ratios(peaks["long"], peaks["short"]), "×", at_most(1.1)),
        ],
        rows=[
            {"clip": name, "round": turn, **run}
            for name, runs in clips.items()
            for turn, run in enumerate(runs)
        ],
        notes=[
            f"{_WIDTH}×{_HEIGHT} at {_FPS} frames/s, H.264, the camera `track`. The time is from the request "
            "to the finished file: the process's start and the trial of its GL context are in it.",
            f"GL: {short[0]['gl_backend']}, {short[0]['gl_renderer']}. Memory is the render process's "
            "greatest resident set.",
        ],
    )


def _stage(folder: Path, seconds: float) -> Run:
    """Write everything that a request needs except its length into the folder."""
    info = catalog.find("ant")
    # An ant on its back keeps kicking, so the video has the length that is measured.
    options = catalog.parse_options(info, {"terminate_when_unhealthy": False})
    environment = catalog.make(info, options, engine_builder("native"))
    shown = rollout(
        environment,
        random_policy(environment.action_size),
        key=jax.random.PRNGKey(0),
        num_steps=round(seconds / environment.dt),
        num_episodes=1,
    )
    trajectory.save(folder / "trajectory.npz", shown)
    mujoco.mj_saveModel(environment.model, str(folder / "model.mjb"), None)
    return {
        "trajectory": str(folder / "trajectory.npz"),
        "model": str(folder / "model.mjb"),
        "tracked_body": environment.tracked_body,
        "video": str(folder / "video.mp4"),
        "poster": str(folder / "video.png"),
        "width": _WIDTH,
        "height": _HEIGHT,
        "fps": _FPS,
    }


def _clip(request: Run, seconds: float) -> Run:
    return run_child("bench.ours.render_clip", {**request, "seconds": seconds}, timeout_s=600)
