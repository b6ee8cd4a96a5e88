"""The control that holds the walker as it begins, from which `zero_action: start` counts."""

import mujoco
import numpy as np


def holding_controls(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """The controls [nu] in [-1, 1] under which no actuator exerts a force at rest in the positions qpos [nq].

    Those of torques are 0. Source: MuJoCo's actuation model, force = gain · control + bias, where a position
    servo's bias is b0 + b1 · length.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    bias = model.actuator_biasprm[:, 0] + model.actuator_biasprm[:, 1] * data.actuator_length
    return np.clip(-bias / model.actuator_gainprm[:, 0], -1.0, 1.0).astype(np.float32)
