"""The terms of a job on a user's own model: observation, reward, termination and reset; no numerical code."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from core.bounds import LONGEST_NAME, MOST_ITEMS, Real
from core.documents import Strict
from core.environments.options import NoiseScale, Range, Weight

Name = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME)]
Names = Annotated[list[Name], Field(min_length=1, max_length=1000)]
Vector = Annotated[tuple[Real, Real, Real], Field(strict=False)]


def _not_zero(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(vector):
        raise ValueError("must not be [0, 0, 0]")
    return vector


Direction = Annotated[Vector, AfterValidator(_not_zero)]


class OfBody(Strict):
    body: Name | None = Field(default=None, description="The body's name; null: the root.")


class OfBodies(Strict):
    bodies: Names | None = Field(default=None, description="The bodies' names; null: all but the world.")


class OfAxis(OfBody):
    axis: Direction = Field(default=(0.0, 0.0, 1.0), description="An axis in the body's own frame.")


class OfHeight(OfBody):
    range: Range = Field(description="[lowest, highest] in metres above the world's origin.")


class OfContact(Strict):
    geoms: Names = Field(description="The geoms' names.")
    against: Name | None = Field(
        default=None, description="Count only contacts with this geom; null: with any."
    )


class Qpos(Strict):
    """Positions of all joints, in MuJoCo's order: m, rad, quaternions w x y z."""

    kind: Literal["qpos"] = "qpos"
    root_position: Literal["all", "height", "none"] | None = Field(
        default=None,
        description="Which of x, y and z of the root's free joint to include; null: the height. A model "
        "without a free joint keeps all positions.",
    )


class Qvel(Strict):
    """Velocities of all joints, in MuJoCo's order: m/s, rad/s."""

    kind: Literal["qvel"] = "qvel"


class PreviousAction(Strict):
    """The previous action; zeros at the start of an episode."""

    kind: Literal["previous_action"] = "previous_action"


class Activation(Strict):
    """The states of actuators that have one."""

    kind: Literal["act"] = "act"


class Sensors(Strict):
    """The model's sensors; those of forces and accelerations are read at the last physics step."""

    kind: Literal["sensors"] = "sensors"
    names: Names | None = Field(default=None, description="The sensors, in this order; null: all.")


class BodyPositions(OfBodies):
    """Positions of bodies in the world, in metres."""

    kind: Literal["body_positions"] = "body_positions"
    relative: bool = Field(default=False, description="Relative to the root, along the world's axes.")


class BodyOrientations(OfBodies):
    """Rotation matrices of bodies, row by row."""

    kind: Literal["body_orientations"] = "body_orientations"


class Cvel(OfBodies):
    """Velocities of bodies: angular in rad/s, then linear in m/s at the centre of mass of their tree."""

    kind: Literal["cvel"] = "cvel"


class Cinert(OfBodies):
    """Inertias of bodies about the centre of mass of their tree, in kg m², kg m and kg."""

    kind: Literal["cinert"] = "cinert"


class ActuatorForces(Strict):
    """The actuators' forces on each degree of freedom in the last physics step, in N or N m."""

    kind: Literal["qfrc_actuator"] = "qfrc_actuator"


ObservationTerm = Annotated[
    Qpos
    | Qvel
    | PreviousAction
    | Activation
    | Sensors
    | BodyPositions
    | BodyOrientations
    | Cvel
    | Cinert
    | ActuatorForces,
    Field(discriminator="kind"),
]


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


class OutsideHeightRange(OfHeight):
    """The body is too low or too high."""

    kind: Literal["height_range"] = "height_range"


class NotUpright(OfAxis):
    """The body leans too far."""

    kind: Literal["upright"] = "upright"
    least: float = Field(
        default=0.0,
        ge=-1,
        lt=1,
        description="Least cosine of the axis' angle to the vertical that still counts as upright.",
    )


class Touching(OfContact):
    """One of the named geoms touches something."""

    kind: Literal["contact"] = "contact"


TerminationTerm = Annotated[OutsideHeightRange | NotUpright | Touching, Field(discriminator="kind")]


class Reset(Strict):
    """How an episode begins; by default in the model's initial state with a little noise."""

    keyframe: Name | Annotated[int, Field(ge=0, le=MOST_ITEMS)] | None = Field(
        default=None,
        description="By name or number: its positions, velocities and states of actuators. null: the "
        "model's custom numeric `init_qpos`, or else `qpos0`.",
    )
    qpos: Annotated[list[Real], Field(min_length=1, max_length=MOST_ITEMS)] | None = Field(
        default=None, description="Initial positions, in MuJoCo's order."
    )
    position_noise: NoiseScale = Field(default=0.01, description="Uniform in ± this: m, rad.")
    velocity_noise: NoiseScale = Field(default=0.01, description="See velocity_distribution: m/s, rad/s.")
    velocity_distribution: Literal["uniform", "normal"] = Field(
        default="uniform", description="Uniform in ± velocity_noise, or normal with that standard deviation."
    )

    @model_validator(mode="after")
    def _begins_once(self) -> Self:
        if self.keyframe is not None and self.qpos is not None:
            raise ValueError("give either keyframe or qpos")
        return self
