"""A small model of whose every number one knows where it comes from."""

from pathlib import Path
from typing import Any

import jax

from core.environments import catalog
from core.environments.environment import Environment
from core.physics.availability import EngineName
from core.physics.choose import engine_builder

MODEL = "sha256:" + "0" * 64

# A ball of 1 kg in the air, with an arm that is held by a hinge and moved by a motor of 2 N m; nothing
# collides but the ball with the floor. Without gravity, what is set stays so.
XML = b"""<mujoco>
  <option timestep="0.01" gravity="0 0 0" integrator="Euler"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <camera name="above" pos="0 0 5"/>
    <body name="ball" pos="0 0 0.5">
      <freejoint name="root"/>
      <geom name="sphere" size="0.1" mass="1"/>
      <site name="middle"/>
      <body name="arm">
        <joint name="elbow" axis="0 1 0" range="-57.29578 57.29578" limited="true"/>
        <geom name="rod" type="capsule" size="0.01" fromto="0 0 0 0.3 0 0" mass="0.1"
          contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="elbow" joint="elbow" gear="2" ctrllimited="true" ctrlrange="-0.5 1.5"/></actuator>
  <sensor><velocimeter name="speed" site="middle"/><jointpos name="angle" joint="elbow"/></sensor>
  <keyframe><key name="raised" qpos="0 0 0.8 1 0 0 0 0.5"/></keyframe>
</mujoco>"""


def options(**given: Any) -> dict[str, Any]:
    return {"model": MODEL, "n_frames": 1, "reset": {"position_noise": 0.0, "velocity_noise": 0.0}, **given}


def build(folder: Path, xml: bytes = XML, engine: EngineName = "native", **given: Any) -> Environment:
    """The probe under these options."""
    file = folder / "model"
    file.write_bytes(xml)
    info = catalog.find("mjcf")
    return catalog.make(info, catalog.parse_options(info, options(**given)), engine_builder(engine), file)


KEY = jax.random.key(0)
