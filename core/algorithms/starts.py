"""Where fresh starts come from, as far as settings and an environment must agree on it."""

from core.environments.info import EnvironmentInfo
from core.errors import Problem, Rejected


def unreachable_curriculum(reset_pool_size: int, environment: EnvironmentInfo) -> Rejected | None:
    """Why a curriculum would change nothing: environments always return to their first states."""
    if reset_pool_size or not environment.has_curriculum:
        return None
    detail = (
        "With reset_pool_size = 0 every environment returns to its own first state for the whole run, so a "
        "curriculum would change nothing: leave reset_pool_size out, or give up the curriculum."
    )
    places = ("/algorithm/reset_pool_size", "/environment/options/curriculum")
    return Rejected(detail, [Problem(place, detail) for place in places])
