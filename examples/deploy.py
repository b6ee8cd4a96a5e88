"""`gaitway export --format robot` in MuJoCo: `deploy.py robot.onnx robot.xml`; arrows steer, others stop."""

import argparse
import json
import time
from collections.abc import Iterator

import mujoco.viewer
import numpy as np
import onnxruntime

LOADS = ("armature", "friction_loss", "joint_damping")
KEYS = {265: (0.1, 0, 0), 264: (-0.1, 0, 0), 263: (0, 0, 0.2), 262: (0, 0, -0.2)}


def with_servos(xml: str, robot: dict) -> mujoco.MjModel:
    """The robot with the servos that it was trained with."""
    spec = mujoco.MjSpec.from_file(xml)
    for part in [*spec.keys, *spec.actuators]:
        spec.delete(part)
    spec.option.timestep = robot["physics_step_s"]
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{robot['integrator'].upper()}")
    if all(geom.type != mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.worldbody.geoms):
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05])
    for joint in robot["joints"]:
        own, effort = spec.joint(joint["name"]), joint["effort"] or 0
        own.armature, own.frictionloss, own.damping[0] = (joint[name] for name in LOADS)
        if joint["target"]:
            servo = spec.add_actuator(target=own.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            servo.set_to_position(kp=joint["stiffness"], kv=joint["damping"])
            servo.gainprm[0] = joint["stiffness"] or joint["damping"] or 1.0  # Of velocities and efforts too.
            servo.forcerange = [-effort, effort]
    return spec.compile()


def measured(model: mujoco.MjModel, data: mujoco.MjData, joints: list[str]) -> dict[str, np.ndarray]:
    """What sensors say; a state estimator would give the linear velocity."""
    mujoco.mju_quat2Mat(axes := np.zeros(9), data.qpos[3:7])
    return {
        "base_linear_velocity": axes.reshape(3, 3).T @ data.qvel[:3],
        "base_angular_velocity": data.qvel[3:6],
        "projected_gravity": -axes[6:],
        "joint_positions": data.qpos[[model.joint(name).qposadr[0] for name in joints]],
        "joint_velocities": data.qvel[[model.joint(name).dofadr[0] for name in joints]],
    }


def drive(file: str, xml: str, command: np.ndarray) -> Iterator[tuple[mujoco.MjModel, mujoco.MjData]]:
    """Each step of the policy; its targets are `data.ctrl`. command: [3], which may change in between."""
    policy = onnxruntime.InferenceSession(file)
    told = policy.get_modelmeta().custom_metadata_map
    about, inputs, state = (json.loads(told[name]) for name in ("about", "inputs", "state"))
    data = mujoco.MjData(model := with_servos(xml, about["robot"]))
    data.qpos[:] = about["robot"]["qpos"]
    values = {one.name: np.zeros((1, one.shape[1]), np.float32) for one in policy.get_inputs()}
    while True:
        seen = {**measured(model, data, told["joint_names"].split(",")), "command": command}
        values |= {one["name"]: np.array([seen[one["name"]]], np.float32) for one in inputs}
        outputs = dict(zip((one.name for one in policy.get_outputs()), policy.run(None, values), strict=True))
        values |= {name: outputs[output] for name, output in state.items()}
        data.ctrl[:] = outputs["joint_targets"][0]
        mujoco.mj_step(model, data, round(about["action"]["held_s"] / model.opt.timestep))
        yield model, data


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, epilog="No window: --command 0.5 0 0 --seconds 2")
    parser.add_argument("files", nargs=2, metavar="FILE", help="the exported robot.onnx and the robot's MJCF")
    parser.add_argument("--command", nargs=3, type=float, help="no window: m/s forward and left, rad/s")
    parser.add_argument("--seconds", type=float, default=1e9, help="of the robot; then its place is printed")
    asked, viewer, began = parser.parse_args(), None, time.monotonic()
    command = np.array(asked.command or [0.0, 0.0, 0.0])
    for model, data in drive(*asked.files, command):
        if asked.command is None:
            steer = lambda key: command.__setitem__(..., command + KEYS[key] if key in KEYS else 0)  # noqa: E731
            viewer = viewer or mujoco.viewer.launch_passive(model, data, key_callback=steer)
            viewer.sync()
            time.sleep(max(0.0, began + data.time - time.monotonic()))
        if data.time > asked.seconds:
            parser.exit(message=f"{data.time:.1f} s: at {data.qpos[:3].round(2)} m\n")
