"""What an action is."""

from core.environments.brittle_star.info import Options
from core.environments.environment import Environment


def controlled(star: Environment, options: Options) -> Environment:
    """The star under `options.control`; itself where actions are the joints' own."""
    match options.control:
        case "joints":
            return star
