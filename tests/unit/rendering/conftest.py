"""GL is tried once in each test process; without any, the tests that draw are skipped, and say why."""

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from core.environments import trajectory
from core.environments.trajectory import Episode, Trajectory
from core.rendering.gl import RenderingFailed, probe
from core.rendering.request import RenderRequest

# A red ball on the stock grey floor and under the stock black sky; it slides along +x.
BALL = """
<mujoco>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="1 1 1" rgb2="0 0 0" width="32" height="32"/>
    <texture name="squares" type="2d" builtin="checker" rgb1="0 0 0" rgb2="0.8 0.8 0.8" width="8" height="8"/>
    <material name="floor" texture="squares" texrepeat="20 20" reflectance="0.5"/>
  </asset>
  <worldbody>
    <light directional="true" pos="0 0 1" dir="0 0 -1"/>
    <geom type="plane" size="40 40 1" material="floor"/>
    <camera name="fixed" pos="0 -3 1" xyaxes="1 0 0 0 0.3 1"/>
    <body name="target" pos="0.8 0 0.5"><geom size="0.15" rgba="0.05 0.8 0.05 1"/></body>
    <body name="ball" pos="0 0 0.5"><freejoint/><geom size="0.3" rgba="0.9 0.05 0.05 1"/></body>
  </worldbody>
</mujoco>
"""


@cache
def why_no_gl() -> str:
    try:
        probe()
    except RenderingFailed as failure:
        return failure.detail
    return ""


@pytest.fixture(scope="session")
def gl() -> None:
    if reason := why_no_gl():
        pytest.skip(reason)


def rolling_ball(seconds: float, *, dt: float = 0.05, speed: float = 3.0) -> Episode:
    num_steps = round(seconds / dt)
    time = dt * np.arange(num_steps + 1)
    qpos = np.zeros((num_steps + 1, 7), np.float32)
    qpos[:, 0], qpos[:, 2], qpos[:, 3] = speed * time, 0.3, 1.0
    return Episode(
        time=time,
        qpos=qpos,
        qvel=np.zeros((num_steps + 1, 6), np.float32),
        position=qpos[:, :3],
        observation=np.zeros((num_steps + 1, 1), np.float32),
        action=np.zeros((num_steps, 0), np.float32),
        reward=np.zeros(num_steps, np.float32),
        terminated=False,
    )


def ball_request(folder: Path, *episodes: Episode, **fields: object) -> RenderRequest:
    """A request for a small video of these episodes, its files in `folder`."""
    model = mujoco.MjModel.from_xml_string(BALL)
    mujoco.mj_saveModel(model, str(folder / "model.mjb"), None)
    trajectory.save(folder / "t.npz", Trajectory(episodes, trajectory.describe(model)))
    return RenderRequest.model_validate(
        {
            "trajectory": folder / "t.npz",
            "model": folder / "model.mjb",
            "tracked_body": model.body("ball").id,
            "video": folder / "video.mp4",
            "poster": folder / "poster.png",
            "width": 160,
            "height": 120,
            "fps": 10,
            **fields,
        }
    )
