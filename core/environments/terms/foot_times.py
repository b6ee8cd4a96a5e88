"""How long each foot has been on the ground or in the air, from step to step; no numerical code.

A foot is on the ground while one of its geoms touches anything.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from core.environments.terms.term import Array

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step

# The derived fields of the physics that are read.
FIELDS = ("sensordata", "xmat", "xpos")
AIR_TIME, CONTACT_TIME, PEAK_HEIGHT = "foot_air_time", "foot_contact_time", "foot_peak_height"


@dataclass(frozen=True)
class FootTimes:
    """Of each foot after a step, all [feet].

    touches: 1 on the ground, otherwise 0. landed: 1 in the step in which it comes down. air_time: seconds of
    the swing that goes on or ended in this step; 0 on the ground. contact_time: seconds since it came down; 0
    in the air. peak_height: the highest that its sole was in the swing that goes on or ended in this step, m.
    """

    touches: Array
    landed: Array
    air_time: Array
    contact_time: Array
    peak_height: Array


def at_start(step: "Step", model: "ModelIndex") -> tuple[FootTimes, dict[str, Array]]:
    """As an episode begins: no swing has begun, so the feet that come down first do not land."""
    touches = model.foot_contacts(step)
    none = 0.0 * touches
    carried = {AIR_TIME: none, CONTACT_TIME: none, PEAK_HEIGHT: none}
    return FootTimes(touches, none, none, none, none), carried


def after(
    carried: Mapping[str, Array], step: "Step", model: "ModelIndex"
) -> tuple[FootTimes, dict[str, Array]]:
    """The times after a step, and what is carried to the next one, by the names of `State.info`.

    A swing's time is counted in whole steps: from the first step that ends in the air to that which ends on
    the ground.
    """
    xp = step.xp
    touches = model.foot_contacts(step)
    landed = touches * xp.where(carried[AIR_TIME] > 0, 1.0, 0.0)
    air_time = (1.0 - touches + landed) * (carried[AIR_TIME] + step.dt)
    contact_time = touches * (carried[CONTACT_TIME] + step.dt)
    highest = xp.maximum(carried[PEAK_HEIGHT], (1.0 - touches) * model.foot_heights(step))
    times = FootTimes(touches, landed, air_time, contact_time, highest)
    in_air = 1.0 - touches
    return times, {
        AIR_TIME: in_air * air_time,
        CONTACT_TIME: contact_time,
        PEAK_HEIGHT: in_air * highest,
    }
