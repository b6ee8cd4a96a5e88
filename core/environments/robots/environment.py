"""A robot of the catalog as an environment."""

from core.environments.mjcf.model import compiled
from core.environments.robots.info import ROBOTS
from core.environments.robots.model import spec
from core.environments.task import TaskEnv
from core.environments.terms.describe import inventory
from core.environments.terms.task import TaskOptions
from core.environments.terrain.model import add_boxes
from core.physics.engine import EngineBuilder


def make(options: TaskOptions, build_engine: EngineBuilder, robot: str) -> TaskEnv:
    """The robot's task under these options. Raises JobFailed("bad_model") where its package is missing."""
    edited = spec(ROBOTS[robot])
    model = compiled(edited)
    parts = inventory(model)
    if options.terrain is not None:
        add_boxes(edited, model, options.terrain)
    stepped = compiled(edited, options.timestep, options.readings(parts), options.sensors)
    return TaskEnv(options, parts, edited, stepped, build_engine)
