"""Options of the corridor that change while a run trains, from a beginning to the options' own values.

To add one, give `Beginning` a field of the option's name and type. What only sets lengths needs no more; of a
number that a step reads, the environment takes the value of its episode's level.
"""

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import Field

from core.bounds import Real
from core.documents import Strict
from core.environments.dm_control.corridor.options import Drawn

# Layouts are drawn before a run, so lengths grow in steps; the last level has the options' own.
NUM_LEVELS = 16
# Which options each arena looks at.
OF_ARENA: Mapping[str, tuple[str, ...]] = {
    "gaps": ("platform_length", "gap_length", "target_velocity"),
    "walls": ("wall_gap", "wall_width", "target_velocity"),
    "empty": (),
}

Options = TypeVar("Options", bound=Strict)


class Beginning(Strict):
    """The options as a run begins, each under the option's own rules; null: it does not change."""

    platform_length: Drawn | None = None
    gap_length: Drawn | None = None
    wall_gap: Drawn | None = None
    wall_width: Drawn | None = None
    target_velocity: Real | None = None

    @property
    def given(self) -> dict[str, Any]:
        """The options that change, with their first values."""
        return {name: value for name, value in self if value is not None}


class Curriculum(Strict):
    """Training begins with other options, which become the environment's own in equal steps.

    What counts is the run's environment steps so far. Evaluations, videos and rollouts have the options' own
    values from the beginning.
    """

    start: Beginning
    over_steps: int = Field(
        ge=1, le=10**12, description="Environment steps after which the options have their own values."
    )


def between(first: Any, last: Any, progress: float) -> Any:
    """A number, or each of a pair, as far from the first to the last as the progress from 0 to 1."""
    if isinstance(first, tuple):
        return tuple(between(a, b, progress) for a, b in zip(first, last, strict=True))
    return first + (last - first) * progress


def at_level(options: Options, curriculum: Curriculum | None, level: int) -> Options:
    """The options at one of NUM_LEVELS levels; unchanged without a curriculum."""
    if curriculum is None or level == NUM_LEVELS - 1:
        return options
    progress = level / (NUM_LEVELS - 1)
    changed = {
        name: between(first, getattr(options, name), progress)
        for name, first in curriculum.start.given.items()
    }
    return options.model_copy(update=changed)


def at_every_level(options: Options, curriculum: Curriculum | None) -> list[Options]:
    """The options at all levels, in their order; one without a curriculum."""
    levels = range(NUM_LEVELS) if curriculum else [NUM_LEVELS - 1]
    return [at_level(options, curriculum, level) for level in levels]
