"""What a body can earn, in a job's words; `core.environments.rewards` computes it."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from core.documents import Strict
from core.environments.mjcf.vocabulary.parts import (
    Direction,
    Name,
    Names,
    OfAxis,
    OfBody,
    OfContact,
    OfHeight,
    Vector,
)
from core.environments.options import Weight


class _Reward(Strict):
    """weight: what the term is multiplied by. name: of its metric, `reward_<name>`; null: its kind."""

    sign: ClassVar[float] = 1.0

    weight: Weight = 1.0
    name: Annotated[str, Field(pattern=r"^[a-z0-9_]{1,60}$")] | None = None


class _Cost(_Reward):
    """Of a cost, a positive weight is what it takes away."""

    sign: ClassVar[float] = -1.0


class ForwardVelocity(OfBody, _Reward):
    """How fast a body, or the centre of mass of all that hangs on it, moves in a direction, in m/s."""

    kind: Literal["forward_velocity"] = "forward_velocity"
    direction: Direction = Field(default=(1.0, 0.0, 0.0), description="In the world; of any length.")
    of: Literal["body", "centre_of_mass"] = "body"


class VelocityTracking(OfBody, _Reward):
    """1 at the wanted horizontal velocity, less the further from it."""

    kind: Literal["velocity_tracking"] = "velocity_tracking"
    velocity: Annotated[tuple[float, float], Field(strict=False)] = Field(
        description="Wanted, [forward, left] in m/s."
    )
    tolerance: float = Field(default=0.5, gt=0, le=100, description="In m/s: so far off it is worth 1/e.")
    frame: Literal["body", "world"] = Field(default="body", description="Whose x and y are forward and left.")


class Upright(OfAxis, _Reward):
    """1 where the body's axis points up, -1 where it points down."""

    kind: Literal["upright"] = "upright"


class HeightRange(OfHeight, _Reward):
    """1 where the body's height is in the range, otherwise 0."""

    kind: Literal["height_range"] = "height_range"


class Alive(_Reward):
    """1 at every step."""

    kind: Literal["alive"] = "alive"


class ControlCost(_Cost):
    """The action's squared norm."""

    kind: Literal["control_cost"] = "control_cost"


class Energy(_Cost):
    """The power that the actuators give and take, in W."""

    kind: Literal["energy"] = "energy"


class ActionRate(_Cost):
    """The squared norm of what changed in the action."""

    kind: Literal["action_rate"] = "action_rate"


class Distance(OfBody, _Cost):
    """From a body to a point, or to another body, in metres."""

    kind: Literal["distance"] = "distance"
    point: Vector | None = Field(default=None, description="In the world, in metres.")
    target: Name | None = Field(default=None, description="The other body.")

    @model_validator(mode="after")
    def _has_one_end(self) -> Self:
        if (self.point is None) == (self.target is None):
            raise ValueError("give either point or target")
        return self


class JointLimits(_Cost):
    """How far joints are beyond the middle part of their ranges, in rad or m, added up."""

    kind: Literal["joint_limits"] = "joint_limits"
    joints: Names | None = Field(
        default=None, description="By name; null: all hinges and slides with a range."
    )
    share: float = Field(default=0.95, gt=0, le=1, description="Of a range, about its middle, that is free.")


class Contact(OfContact, _Reward):
    """How many of the named geoms touch something; give a negative weight where they should not."""

    kind: Literal["contact"] = "contact"


RewardTerm = Annotated[
    ForwardVelocity
    | VelocityTracking
    | Upright
    | HeightRange
    | Alive
    | ControlCost
    | Energy
    | ActionRate
    | Distance
    | JointLimits
    | Contact,
    Field(discriminator="kind"),
]
