"""The terms of a reward.

Names and forms are common to locomotion tasks: Brax and Gymnasium (forward velocity, alive, control cost),
legged_gym and MuJoCo Playground (velocity tracking, action rate, energy, joint limits).
"""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from core.bounds import Real
from core.environments.terms.inventory import ModelParts
from core.environments.terms.readings import Reading
from core.environments.terms.term import (
    Array,
    CostTerm,
    Direction,
    Name,
    Names,
    OfAxis,
    OfBody,
    OfBodyContact,
    OfContact,
    OfHeight,
    RewardTerm,
    Term,
    Vector,
    unit_vector,
)
from core.environments.terms.terminations import AnyTermination

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step


class ForwardVelocity(OfBody, RewardTerm):
    """d · (p' − p) / dt: speed of a body, or of its subtree's centre of mass, in a direction, in m/s."""

    kind: Literal["forward_velocity"] = "forward_velocity"
    direction: Direction = Field(default=(1.0, 0.0, 0.0), description="A vector in the world, of any length.")
    of: Literal["body", "centre_of_mass"] = "body"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        body = model.body(self.body)
        velocity = model.velocity(step, body, self.of)
        if (axis := self._axis) is not None:  # The same number as by the product, and faster.
            return velocity[axis] if self.direction[axis] > 0 else -velocity[axis]
        return step.xp.dot(velocity, unit_vector(self.direction, step))

    @property
    def _axis(self) -> int | None:
        """The world's axis that the direction lies along."""
        along = [axis for axis, part in enumerate(self.direction) if part]
        return along[0] if len(along) == 1 else None


class VelocityTracking(OfBody, RewardTerm):
    """exp(−‖v − v*‖² / σ²): 1 at the target horizontal velocity, and less the further the velocity is from
    it."""

    kind: Literal["velocity_tracking"] = "velocity_tracking"
    velocity: Annotated[tuple[Real, Real], Field(strict=False)] = Field(
        description="The target velocity, [forward, left] in m/s."
    )
    tolerance: float = Field(default=0.5, gt=0, le=100, description="Error at which the term is 1/e, in m/s.")
    frame: Literal["body", "world"] = Field(
        default="body", description="The frame whose x and y are forward and left."
    )

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        body = model.body(self.body)
        velocity = model.velocity(step, body)
        if self.frame == "body":
            velocity = step.after.derived["xmat"][body].reshape(3, 3).T @ velocity
        error = velocity[:2] - step.array(self.velocity)
        return step.xp.exp(-step.xp.sum(error**2) / self.tolerance**2)


class Upright(OfAxis, RewardTerm):
    """(R a)_z: 1 where the body's axis points up, -1 where it points down."""

    kind: Literal["upright"] = "upright"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return self.cosine(step, model)


class HeightRange(OfHeight, RewardTerm):
    """1 where the body's height is in the range, otherwise 0."""

    kind: Literal["height_range"] = "height_range"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return self.is_inside(step, model)


class Alive(RewardTerm):
    """1 at every step."""

    kind: Literal["alive"] = "alive"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.ones(())


class Healthy(RewardTerm):
    """1 where none of these terms would end an episode, otherwise 0."""

    kind: Literal["healthy"] = "healthy"
    unless: list[AnyTermination] = Field(min_length=1, max_length=64, description="Terms of `termination`.")

    @property
    def inner(self) -> Sequence[Term]:
        return self.unless

    def readings(self, parts: ModelParts) -> Iterable[Reading]:
        return [reading for term in self.unless for reading in term.readings(parts)]

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        ended = step.xp.stack([term.measure(step, model) for term in self.unless])
        return 1.0 - step.xp.max(ended)


class ControlCost(CostTerm):
    """Σ a²: the squared norm of the action, or of the control that it sets."""

    usual_weight = 0.05

    kind: Literal["control_cost"] = "control_cost"
    of: Literal["action", "control"] = "action"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.sum((step.action if self.of == "action" else step.control) ** 2)


class Energy(CostTerm):
    """Σ |τ q̇|: the actuators' absolute power, in W."""

    usual_weight = 0.001

    kind: Literal["energy"] = "energy"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.sum(abs(step.after.derived["qfrc_actuator"] * step.after.qvel))


class ElectricalPower(CostTerm):
    """Σ max(0, τ q̇): the power that actuators put into joints, in W; they take none back.

    Source: mjlab's `electrical_power_cost`.
    """

    usual_weight = 0.001

    kind: Literal["electrical_power"] = "electrical_power"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.sum(step.xp.maximum(step.after.derived["qfrc_actuator"] * step.after.qvel, 0.0))


class ActionRate(CostTerm):
    """Σ (aₜ − aₜ₋₁)²: the squared norm of the action's change since the last step."""

    remembers = frozenset({"previous_action"})
    usual_weight = 0.02

    kind: Literal["action_rate"] = "action_rate"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.sum((step.action - step.previous_action) ** 2)


class ActionAcceleration(CostTerm):
    """Σ (aₜ − 2 aₜ₋₁ + aₜ₋₂)²: the squared norm of the change of the action's change; actions before an
    episode's first are 0.

    Source: mjlab's `action_acc_l2`; the second difference of actions in Playground's smoothness costs.
    """

    remembers = frozenset({"earlier_action", "previous_action"})
    usual_weight = 0.01

    kind: Literal["action_acceleration"] = "action_acceleration"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.sum((step.action - 2.0 * step.previous_action + step.earlier_action) ** 2)


class Distance(OfBody, CostTerm):
    """‖p − p*‖: the distance from a body to a point, or to another body, in metres."""

    kind: Literal["distance"] = "distance"
    point: Vector | None = Field(default=None, description="A point in the world, in metres.")
    target: Name | None = Field(default=None, description="The other body.")

    @model_validator(mode="after")
    def _has_one_end(self) -> Self:
        if (self.point is None) == (self.target is None):
            raise ValueError("give either point or target")
        return self

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        position = model.position(step.after, model.body(self.body))
        end = (
            model.position(step.after, model.body(self.target))
            if self.point is None
            else step.array(self.point)
        )
        return step.xp.linalg.norm(position - end)


class JointLimits(CostTerm):
    """Σ max(0, |q − m| − s h): how far joints are outside the middle part of their ranges, in rad or m.
    m: the middle of a joint's range, h: half of its width."""

    usual_weight = 2.0

    kind: Literal["joint_limits"] = "joint_limits"
    joints: Names | None = Field(
        default=None, description="The joints' names; null: all hinges and slides with a range."
    )
    share: float = Field(
        default=0.95, gt=0, le=1, description="The part of a range, around its middle, that costs nothing."
    )

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        joints = model.limited_joints(self.joints)
        low, high = step.array(model.model.jnt_range[joints].T)
        middle, half = (low + high) / 2, (high - low) / 2
        outside = abs(step.after.qpos[model.model.jnt_qposadr[joints]] - middle) - self.share * half
        return step.xp.sum(step.xp.maximum(0.0, outside))


class Contact(OfContact, RewardTerm):
    """How many of the named geoms touch something; a negative weight discourages it."""

    usual_weight = -1.0

    kind: Literal["contact"] = "contact"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return self.num_touching(step, model)


class UndesiredContacts(OfBodyContact, CostTerm):
    """How many of the bodies touch something."""

    kind: Literal["undesired_contacts"] = "undesired_contacts"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return self.num_touching(step, model)


CommonReward = (
    ForwardVelocity
    | VelocityTracking
    | Upright
    | HeightRange
    | Alive
    | Healthy
    | ControlCost
    | Energy
    | ElectricalPower
    | ActionRate
    | ActionAcceleration
    | Distance
    | JointLimits
    | Contact
    | UndesiredContacts
)
