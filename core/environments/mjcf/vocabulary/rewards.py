"""The reward terms of a job; `core.environments.rewards` computes them."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from core.bounds import Real
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
    """weight: multiplies the term. name: its metric is `reward_<name>`; null: its kind."""

    sign: ClassVar[float] = 1.0

    weight: Weight = 1.0
    name: Annotated[str, Field(pattern=r"^[a-z0-9_]{1,60}$")] | None = None


class _Cost(_Reward):
    """A term that is subtracted where its weight is positive."""

    sign: ClassVar[float] = -1.0


class ForwardVelocity(OfBody, _Reward):
    """Speed of a body, or of its subtree's centre of mass, in a direction, in m/s."""

    kind: Literal["forward_velocity"] = "forward_velocity"
    direction: Direction = Field(default=(1.0, 0.0, 0.0), description="A vector in the world, of any length.")
    of: Literal["body", "centre_of_mass"] = "body"


class VelocityTracking(OfBody, _Reward):
    """1 at the target horizontal velocity, and less the further the velocity is from it."""

    kind: Literal["velocity_tracking"] = "velocity_tracking"
    velocity: Annotated[tuple[Real, Real], Field(strict=False)] = Field(
        description="The target velocity, [forward, left] in m/s."
    )
    tolerance: float = Field(default=0.5, gt=0, le=100, description="Error at which the term is 1/e, in m/s.")
    frame: Literal["body", "world"] = Field(
        default="body", description="The frame whose x and y are forward and left."
    )


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
    """The actuators' absolute power, in W."""

    kind: Literal["energy"] = "energy"


class ActionRate(_Cost):
    """The squared norm of the action's change since the last step."""

    kind: Literal["action_rate"] = "action_rate"


class Distance(OfBody, _Cost):
    """The distance from a body to a point, or to another body, in metres."""

    kind: Literal["distance"] = "distance"
    point: Vector | None = Field(default=None, description="A point in the world, in metres.")
    target: Name | None = Field(default=None, description="The other body.")

    @model_validator(mode="after")
    def _has_one_end(self) -> Self:
        if (self.point is None) == (self.target is None):
            raise ValueError("give either point or target")
        return self


class JointLimits(_Cost):
    """The sum of how far joints are outside the middle part of their ranges, in rad or m."""

    kind: Literal["joint_limits"] = "joint_limits"
    joints: Names | None = Field(
        default=None, description="The joints' names; null: all hinges and slides with a range."
    )
    share: float = Field(
        default=0.95, gt=0, le=1, description="The part of a range, around its middle, that costs nothing."
    )


class Contact(OfContact, _Reward):
    """How many of the named geoms touch something; a negative weight discourages it."""

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
