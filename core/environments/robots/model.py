"""A robot's model: from the file of an installed package, which is not imported, to a specification."""

from importlib.util import find_spec
from pathlib import Path

import mujoco

from core.environments.mjcf.edit_options import ModelEdits
from core.environments.mjcf.edits import edit
from core.environments.robots.info import ROBOTS
from core.environments.robots.robot import Robot
from core.environments.task import solver_settings
from core.environments.terms.task import TaskOptions
from core.errors import JobFailed
from core.installation import to_install_robots
from core.physics.engine import SolverSettings
from core.reasons import Reason


def robot(name: str, options: TaskOptions) -> tuple[mujoco.MjSpec, SolverSettings]:
    """The catalog's robot, and how far engines solve. Raises like `spec`."""
    return spec(ROBOTS[name]), solver_settings(options)


def spec(robot: Robot, edits: ModelEdits | None = None) -> mujoco.MjSpec:
    """The robot before it is compiled. edits: in place of its own.

    Raises JobFailed("bad_model") where the package is not installed.
    """
    found = mujoco.MjSpec.from_file(str(file_of(robot)))
    if robot.timestep is not None:
        found.option.timestep = robot.timestep
    edit(found, robot.edits if edits is None else edits)
    return found


def file_of(robot: Robot) -> Path:
    """The robot's MJCF. Raises JobFailed("bad_model") where the package is not installed."""
    package = find_spec(robot.package)
    for folder in (package.submodule_search_locations or []) if package is not None else []:
        if (path := Path(folder, robot.file)).is_file():
            return path
    raise JobFailed(
        Reason.BAD_MODEL,
        f"The model of {robot.name} comes with the package {robot.package}, which this worker does not have. "
        f"Install it there with `{to_install_robots()}`, or ask for another environment.",
    )
