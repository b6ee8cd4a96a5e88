"""The words a job may describe its reward, observation, ending and beginning with; imports no numerical code.

What each means is said at the function that computes it: `rewards.py`, `observations.py`, `terminations.py`.
"""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from core.environments.options import NoiseScale, Range, Weight
from core.model import Strict

Name = Annotated[str, Field(min_length=1, max_length=200)]
Names = Annotated[list[Name], Field(min_length=1, max_length=1000)]
Vector = Annotated[tuple[float, float, float], Field(strict=False)]
Body = Annotated[Name | None, Field(description="By name; null: the root.")]
Geoms = Annotated[Names, Field(description="By name.")]
Bodies = Annotated[Names | None, Field(description="By name; null: all but the world.")]


class _Reward(Strict):
    """weight: what the term is multiplied by. name: of its metric, `reward_<name>`; null: its kind."""

    weight: Weight = 1.0
    name: Annotated[str, Field(pattern=r"^[a-z0-9_]{1,60}$")] | None = None


class _Cost(_Reward):
    """Of a cost, a positive weight is what it takes away."""


class ForwardVelocity(_Reward):
    """How fast a body, or the centre of mass of all that hangs on it, moves in a direction, in m/s."""

    kind: Literal["forward_velocity"] = "forward_velocity"
    body: Body = None
    direction: Vector = Field(default=(1.0, 0.0, 0.0), description="In the world; of any length.")
    of: Literal["body", "centre_of_mass"] = "body"

    @model_validator(mode="after")
    def _has_a_direction(self) -> Self:
        if not any(self.direction):
            raise ValueError("direction must not be [0, 0, 0]")
        return self


class VelocityTracking(_Reward):
    """1 at the wanted horizontal velocity, less the further from it."""

    kind: Literal["velocity_tracking"] = "velocity_tracking"
    body: Body = None
    velocity: Annotated[tuple[float, float], Field(strict=False)] = Field(
        description="Wanted, [forward, left] in m/s."
    )
    tolerance: float = Field(default=0.5, gt=0, le=100, description="In m/s: so far off it is worth 1/e.")
    frame: Literal["body", "world"] = Field(default="body", description="Whose x and y are forward and left.")


class Upright(_Reward):
    """1 where the body's axis points up, -1 where it points down."""

    kind: Literal["upright"] = "upright"
    body: Body = None
    axis: Vector = Field(default=(0.0, 0.0, 1.0), description="In the body's own frame.")

    @model_validator(mode="after")
    def _has_an_axis(self) -> Self:
        if not any(self.axis):
            raise ValueError("axis must not be [0, 0, 0]")
        return self


class HeightRange(_Reward):
    """1 where the body's height is in the range, otherwise 0."""

    kind: Literal["height_range"] = "height_range"
    body: Body = None
    range: Range = Field(description="[lowest, highest] in metres above the world's origin.")


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


class Distance(_Cost):
    """From a body to a point, or to another body, in metres."""

    kind: Literal["distance"] = "distance"
    body: Body = None
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


class Contact(_Reward):
    """How many of the named geoms touch something; give a negative weight where they should not."""

    kind: Literal["contact"] = "contact"
    geoms: Geoms
    against: Name | None = Field(default=None, description="The geom that counts; null: any.")


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


class Qpos(Strict):
    """Positions of all joints, in MuJoCo's order: m, rad, quaternions w x y z."""

    kind: Literal["qpos"] = "qpos"
    root_position: Literal["all", "height", "none"] | None = Field(
        default=None,
        description="What of the root's free joint's x, y, z is seen; null: the height, and all that a "
        "model without a free joint has.",
    )


class Qvel(Strict):
    """Velocities of all joints, in MuJoCo's order: m/s, rad/s."""

    kind: Literal["qvel"] = "qvel"


class PreviousAction(Strict):
    """What was done last; zeros at an episode's begin."""

    kind: Literal["previous_action"] = "previous_action"


class Activation(Strict):
    """The states of actuators that have one."""

    kind: Literal["act"] = "act"


class Sensors(Strict):
    """What the model's sensors read; those of forces and accelerations, at the last physics step."""

    kind: Literal["sensors"] = "sensors"
    names: Names | None = Field(default=None, description="Which, in this order; null: all there are.")


class BodyPositions(Strict):
    """Where bodies are in the world, in metres."""

    kind: Literal["body_positions"] = "body_positions"
    bodies: Bodies = None
    relative: bool = Field(default=False, description="To the root, along the world's axes.")


class BodyOrientations(Strict):
    """Rotation matrices of bodies, row by row."""

    kind: Literal["body_orientations"] = "body_orientations"
    bodies: Bodies = None


class Cvel(Strict):
    """Velocities of bodies: angular in rad/s, then linear in m/s at the centre of mass of their tree."""

    kind: Literal["cvel"] = "cvel"
    bodies: Bodies = None


class Cinert(Strict):
    """Inertias of bodies about the centre of mass of their tree, in kg m², kg m and kg."""

    kind: Literal["cinert"] = "cinert"
    bodies: Bodies = None


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


class OutsideHeightRange(Strict):
    """The body is too low or too high."""

    kind: Literal["height_range"] = "height_range"
    body: Body = None
    range: Range = Field(description="[lowest, highest] in metres above the world's origin.")


class NotUpright(Strict):
    """The body leans too far."""

    kind: Literal["upright"] = "upright"
    body: Body = None
    axis: Vector = Field(default=(0.0, 0.0, 1.0), description="In the body's own frame.")
    least: float = Field(
        default=0.0,
        ge=-1,
        lt=1,
        description="Cosine of the axis' angle to the vertical: so much is upright.",
    )


class Touching(Strict):
    """One of the named geoms touches something."""

    kind: Literal["contact"] = "contact"
    geoms: Geoms
    against: Name | None = Field(default=None, description="The geom that counts; null: any.")


TerminationTerm = Annotated[OutsideHeightRange | NotUpright | Touching, Field(discriminator="kind")]


class Reset(Strict):
    """How an episode begins; without anything, as the model says, and with a little noise."""

    keyframe: Name | Annotated[int, Field(ge=0)] | None = Field(
        default=None,
        description="By name or number; null: the model's custom numeric `init_qpos`, or `qpos0`.",
    )
    qpos: Annotated[list[float], Field(min_length=1, max_length=10_000)] | None = Field(
        default=None, description="Positions, in MuJoCo's order."
    )
    position_noise: NoiseScale = Field(default=0.01, description="Uniform within ± this: m, rad.")
    velocity_noise: NoiseScale = Field(default=0.01, description="m/s, rad/s.")
    velocity_distribution: Literal["uniform", "normal"] = Field(
        default="uniform", description="Uniform within ± velocity_noise, or normal with it as deviation."
    )

    @model_validator(mode="after")
    def _begins_once(self) -> Self:
        if self.keyframe is not None and self.qpos is not None:
            raise ValueError("give either keyframe or qpos")
        return self
