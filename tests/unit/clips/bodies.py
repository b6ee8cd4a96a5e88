"""A small body that walks in the tests of clips, and its clips."""

from typing import Any

import mujoco
import numpy as np

from core.clips.clip import Clip

# 1 m high with two legs. Hips turn about tilted axes, which mirror each other.
WALKER = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="torso" pos="0 0 0.95">
      <freejoint name="root"/>
      <geom type="box" size="0.1 0.15 0.2" pos="0 0 0.1"/>
      <body name="head" pos="0 0 0.35">
        <joint name="neck" axis="0 0 1" range="-60 60"/>
        <geom type="ellipsoid" size="0.1 0.08 0.12" pos="0.03 0 0.1"/>
      </body>
      <body name="left_thigh" pos="0 0.1 -0.1">
        <joint name="left_hip_pitch" axis="0.1 1 0.2" range="-90 90"/>
        <joint name="left_hip_roll" axis="1 0 0" range="-30 60"/>
        <geom type="capsule" size="0.05" fromto="0 0 0 0 0 -0.4"/>
        <body name="left_shin" pos="0 0 -0.4">
          <joint name="left_knee" axis="0 1 0" range="0 120"/>
          <geom type="capsule" size="0.05" fromto="0 0 0 0 0 -0.4"/>
        </body>
      </body>
      <body name="right_thigh" pos="0 -0.1 -0.1">
        <joint name="right_hip_pitch" axis="-0.1 1 -0.2" range="-90 90"/>
        <joint name="right_hip_roll" axis="1 0 0" range="-60 30"/>
        <geom type="capsule" size="0.05" fromto="0 0 0 0 0 -0.4"/>
        <body name="right_shin" pos="0 0 -0.4">
          <joint name="right_knee" axis="0 -1 0" range="-120 0"/>
          <geom type="capsule" size="0.05" fromto="0 0 0 0 0 -0.4"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
JOINTS = (
    "neck",
    "left_hip_pitch",
    "left_hip_roll",
    "left_knee",
    "right_hip_pitch",
    "right_hip_roll",
    "right_knee",
)
BY_DEPTH = (
    "neck",
    "left_hip_pitch",
    "left_hip_roll",
    "right_hip_pitch",
    "right_hip_roll",
    "left_knee",
    "right_knee",
)


def walker() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(WALKER)


def walking(num_frames: int = 61, rate: float = 30.0, **changes: Any) -> Clip:
    """It goes round a circle of 1 m and swings its legs by 0.3 rad, its feet close to the floor."""
    time = np.arange(num_frames) / rate
    zero, swing = np.zeros_like(time), np.sin(2 * np.pi * time)
    heading = 2.0 * time
    parts: dict[str, Any] = {
        "name": "walk",
        "rate": rate,
        "root_position": np.stack([np.sin(heading), 1 - np.cos(heading), zero + 0.96], axis=1),
        "root_orientation": np.stack([np.cos(heading / 2), zero, zero, np.sin(heading / 2)], axis=1),
        "joints": JOINTS,
        "joint_positions": np.stack(
            [0.4 * swing, 0.3 * swing, zero + 0.02, zero + 0.1, -0.3 * swing, zero + 0.03, zero - 0.15],
            axis=1,
        ),
    }
    return Clip(**parts | changes)
