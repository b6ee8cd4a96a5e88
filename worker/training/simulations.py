"""The physics with which the page steps a trained body itself: `simulation.json` (docs/push.md)."""

import json
from typing import Any

from core.environments.environment import Environment, Wrapped
from core.environments.mujoco_env import MujocoEnv
from core.environments.simulation import NotSimulated
from worker.training.event_writer import EventWriter

NAME = "simulation.json"


def keep_simulation(environment: Environment, events: EventWriter) -> None:
    """Keep the file, which says why if the body cannot be stepped."""
    try:
        document = _document(environment)
    except NotSimulated as error:
        document = {"refusal": f"This body cannot be pushed: {error}."}
    content = json.dumps(document, separators=(",", ":")).encode()
    facts = {"can_run": "refusal" not in document}
    events.keep(NAME, content, "simulation", "application/json", metadata=facts)


def _document(environment: Environment) -> dict[str, Any]:
    """The simulation of the body as its model says; a randomised body differs from it in each episode."""
    while isinstance(environment, Wrapped):
        environment = environment.environment
    if not isinstance(environment, MujocoEnv):
        raise NotSimulated("its environment is that of another package")
    try:
        return environment.simulation().document()
    except (ValueError, RuntimeError) as error:  # Models of users may have anything in them.
        raise NotSimulated(f"its model cannot be written as XML: {error}") from error
