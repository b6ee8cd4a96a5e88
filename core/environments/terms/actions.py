"""How a policy's action becomes the actuators' controls."""

from typing import Annotated, Literal

from pydantic import Field

from core.bounds import Real
from core.documents import Strict
from core.environments.patterns import PATTERNS, PerName


class ControlAction(Strict):
    """±1 is an end of a control's range; without a range, the action is the control itself."""

    kind: Literal["control"] = "control"
    scaled: bool = Field(
        default=True, description="false: the action is the control itself, whatever the range."
    )


class JointPositionAction(Strict):
    """A target for each joint's servo: its position at an episode's start, plus the action times a scale."""

    kind: Literal["joint_position"] = "joint_position"
    scale: Real | PerName | None = Field(
        default=None,
        description="rad or m for an action of 1: one number, or by joint; null: where half of the "
        f"servo's greatest force pushes, or 0.25 where it has no limit. {PATTERNS}",
    )


AnyAction = Annotated[ControlAction | JointPositionAction, Field(discriminator="kind")]
