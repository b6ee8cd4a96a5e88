"""What terms remember of earlier steps, such as the previous action; imports no numerical code."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from core.environments.terms.term import Array, Memory

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step

# The derived fields of the physics from which the times of feet follow.
_FIELDS = ("sensordata", "xmat", "xpos")
AIR_TIME, CONTACT_TIME, PEAK_HEIGHT = "foot_air_time", "foot_contact_time", "foot_peak_height"


@dataclass(frozen=True)
class FootTimes:
    """How long each foot has been on the ground or in the air, after a step; all [feet]. A foot is on the
    ground while one of its geoms touches anything.

    touches: 1 on the ground, otherwise 0. landed: 1 in the step in which it comes down. air_time: seconds of
    the swing that goes on or ended in this step; 0 on the ground. contact_time: seconds since it came down; 0
    in the air. peak_height: the highest that its sole was in the swing that goes on or ended in this step, m.
    """

    touches: Array
    landed: Array
    air_time: Array
    contact_time: Array
    peak_height: Array


class StepMemory:
    """names: what is remembered. derived: the fields of the physics that it reads."""

    def __init__(self, names: frozenset[Memory], model: "ModelIndex") -> None:
        self._names, self._model = names, model
        self.derived = frozenset(_FIELDS if "foot_times" in names else ())

    def begun(self, step: "Step") -> tuple["Step", dict[str, Array]]:
        """The step as an episode begins, with what terms remember, and entries of `State.info`. step: its
        action is 0."""
        entries: dict[str, Array] = {}
        if "start" in self._names:
            entries["start"] = self._model.position(step.after, self._model.root)
            step = replace(step, start=entries["start"])
        if "previous_action" in self._names:
            entries["previous_action"] = step.action
        if "earlier_action" in self._names:
            entries["earlier_action"] = step.action
            step = replace(step, earlier_action=step.action)
        if "foot_times" in self._names:
            times, carried = _first_times(step, self._model)
            entries |= carried
            step = replace(step, foot_times=times)
        return step, entries

    def after(self, step: "Step", info: Mapping[str, Array]) -> tuple["Step", dict[str, Array]]:
        """The same after a step."""
        entries: dict[str, Array] = {}
        step = replace(step, start=info.get("start"), previous_action=info.get("previous_action"))
        if "previous_action" in self._names:
            entries["previous_action"] = step.action
        if "earlier_action" in self._names:
            entries["earlier_action"] = step.previous_action
            step = replace(step, earlier_action=info["earlier_action"])
        if "foot_times" in self._names:
            times, carried = _next_times(info, step, self._model)
            entries |= carried
            step = replace(step, foot_times=times)
        return step, entries


def _first_times(step: "Step", model: "ModelIndex") -> tuple[FootTimes, dict[str, Array]]:
    """As an episode begins: no swing has begun, so the feet that come down first do not land."""
    touches = model.foot_contacts(step)
    none = 0.0 * touches
    carried = {AIR_TIME: none, CONTACT_TIME: none, PEAK_HEIGHT: none}
    return FootTimes(touches, none, none, none, none), carried


def _next_times(
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
