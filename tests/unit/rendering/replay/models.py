"""Small models and motions for the tests of replays."""

from typing import Any

import mujoco
import numpy as np

from core.rendering.timeline import EpisodeMotion

# One of each type of geom that needs no file, all of which a viewer shows; the last geom is hidden.
SHAPES = """
<mujoco>
  <asset>
    <texture name="squares" type="2d" builtin="checker" rgb1="0 0 0" rgb2="1 1 1" width="8" height="8"/>
    <material name="floor" texture="squares" texrepeat="3 3" texuniform="true"/>
    <mesh name="tent" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/>
    <hfield name="hill" nrow="3" ncol="3" size="2 2 1 0.1" elevation="0 0 0  0 1 0  0 0 0"/>
  </asset>
  <worldbody>
    <geom name="plane" type="plane" size="4 2 1" material="floor"/>
    <geom name="endless" type="plane" size="0 0 1" material="floor" pos="0 0 -1"/>
    <geom name="hill" type="hfield" hfield="hill" pos="9 0 0"/>
    <body pos="0 0 3"><freejoint/>
      <geom name="sphere" type="sphere" size="0.5"/>
      <geom name="capsule" type="capsule" size="0.2 0.7"/>
      <geom name="cylinder" type="cylinder" size="0.3 0.4"/>
      <geom name="box" type="box" size="0.1 0.2 0.3"/>
      <geom name="ellipsoid" type="ellipsoid" size="0.1 0.2 0.4"/>
      <geom name="mesh" type="mesh" mesh="tent"/>
      <geom name="unseen" type="sphere" size="2" group="3"/>
      <site name="mark" type="box" size="0.05 0.05 0.05"/>
      <site name="no mark" size="0.5" group="4"/>
    </body>
  </worldbody>
</mujoco>
"""

# A ball and a pendulum on it, a floor, a target, a tendon from the ball to the floor.
ARM = """
<mujoco>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <site name="anchor" pos="0 1 0"/>
    <body name="target" pos="0 0 0.25"><geom size="0.1" contype="0" conaffinity="0"/></body>
    <body name="ball" pos="0 0 0.3"><freejoint/><geom size="0.3"/><site name="top" pos="0 0 0.3"/>
      <body name="arm" pos="0 0 0.3"><joint type="hinge" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 1" size="0.05"/>
      </body>
    </body>
  </worldbody>
  <tendon><spatial name="rope" width="0.02"><site site="anchor"/><site site="top"/></spatial></tendon>
</mujoco>
"""


def model_of(xml: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(xml)


def rolling(num_states: int = 41, dt: float = 0.025, **also: Any) -> EpisodeMotion:
    """The ball of ARM rolls along x for a second, turns about y, and its arm swings."""
    time = dt * np.arange(num_states)
    qpos = np.zeros((num_states, 8))
    qpos[:, 0], qpos[:, 2] = 3 * time, 0.299
    qpos[:, 3], qpos[:, 5], qpos[:, 7] = np.cos(5 * time), np.sin(5 * time), np.sin(7 * time)
    return EpisodeMotion(time, qpos, **also)
