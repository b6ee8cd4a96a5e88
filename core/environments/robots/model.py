"""A robot's model: from the file of an installed package, which is not imported, to a specification."""

from pathlib import Path

import mujoco

from core.environments import optional_packages
from core.environments.mjcf.edit_options import ModelEdits
from core.environments.mjcf.edits import edit
from core.environments.robots.info import ROBOTS
from core.environments.robots.robot import Robot
from core.environments.task_model import solver_settings
from core.environments.terms.task import TaskOptions
from core.installation import to_install_robots
from core.physics.engine import SolverSettings


def robot(name: str, options: TaskOptions) -> tuple[mujoco.MjSpec, SolverSettings]:
    """The catalog's robot, and how far engines solve. One that begins fallen lies on all that collides in its
    file, not on its feet alone. Raises like `spec`."""
    found = ROBOTS[name]
    lies = None if options.reset.fallen is None else found.edits.model_copy(update={"collide": "floor"})
    return spec(found, lies), solver_settings(options)


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
    brings = f"The model of {robot.name} comes with the package {robot.package}"
    return optional_packages.file(robot.package, robot.file, brings=brings, install=to_install_robots())
