"""Which oscillator moves which actuator, by the actuators' names and not by their order."""

import re

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.errors import JobFailed
from core.reasons import Reason

_NAME = re.compile(r"arm_(?P<arm>\d+)_.*?(?P<plane>in_plane|out_of_plane)")


def oscillator_of_actuator(model: mujoco.MjModel, num_arms: int) -> NDArray[np.intp]:
    """[nu]: every segment of an arm follows its arm's oscillator in the plane, or that out of it.

    Raises JobFailed("bad_model") for an actuator that is not that of an arm's joint, by its name.
    """
    return np.array([_oscillator(model.actuator(index).name, num_arms) for index in range(model.nu)], np.intp)


def _oscillator(actuator: str, num_arms: int) -> int:
    found = _NAME.search(actuator)
    if found is None or int(found["arm"]) >= num_arms:
        raise JobFailed(
            Reason.BAD_MODEL,
            f"A CPG of {num_arms} arms cannot use the actuator {actuator!r}: its name must give an arm and a "
            "plane, as in 'arm_0_segment_2_in_plane_joint'.",
        )
    return 2 * int(found["arm"]) + (found["plane"] == "out_of_plane")
