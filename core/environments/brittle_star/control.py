"""What an action controls."""

from core.environments.brittle_star.options import Options
from core.environments.cpg.actions import steered_by_oscillators
from core.environments.environment import Environment


def controlled(star: Environment, options: Options) -> Environment:
    """The star under `options.control`; unchanged if actions are the joints' own."""
    match options.control:
        case "joints":
            return star
        case "cpg":
            return steered_by_oscillators(star, options.num_arms, options.cpg)
