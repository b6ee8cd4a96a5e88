"""Options that make the corridor dm_control's task `RunThroughCorridor`."""

from typing import Literal

from pydantic import Field

from core.documents import Strict
from core.environments.dm_control.corridor.observables import Observable
from core.environments.dm_control.corridor.walkers import Walker
from core.environments.options import Weight

Aesthetic = Literal["checkered", "default", "outdoor_natural"]


class TaskOptions(Strict):
    """dm_control's reward, terminations, observables and looks; by default the notebook's stay alone."""

    target_velocity: float | None = Field(
        None,
        gt=0,
        le=100,
        description="Metres per second in +x: adds dm_control's reward, 1 at this velocity and 0 at rest and "
        "at twice this velocity; null: none.",
    )
    target_velocity_weight: Weight = Field(1.0, description="Weight of the reward for `target_velocity`.")
    contact_termination: bool = Field(
        False, description="Whether the episode ends where a part that is no foot touches the ground."
    )
    terminate_at_height: float | None = Field(
        None,
        ge=-10,
        le=0,
        description="The episode ends where an end effector is below this height, in metres; null: none.",
    )
    observables: list[Observable] = Field(
        [],
        max_length=64,
        description="MuJoCo's fields that follow positions and velocities in the observation; `cinert` and "
        "`cvel` of the walker's bodies.",
    )
    egocentric_depth: int = Field(
        0,
        ge=0,
        le=64,
        description="Side, in pixels, of a square image by the walker's own camera, at the observation's "
        "end: how far away the arena is behind each pixel, in metres, 10 at most. 0: no image.",
    )
    aesthetic: Aesthetic = Field(
        "checkered",
        description="How ground and sky are drawn: Gaitway's squares, or dm_control's aesthetic.",
    )


def check_stands_on_its_feet(options: TaskOptions, walker: Walker) -> None:
    """Raises ValueError if contacts would end every episode as it begins."""
    if options.contact_termination and walker == "rodent":
        raise ValueError(
            "contact_termination would end every episode as it begins: the rodent stands on its forearms, "
            "which are no feet in dm_control; use terminate_at_height or healthy_z_range"
        )
