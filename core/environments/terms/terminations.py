"""The terms that end an episode."""

from math import cos, pi
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from core.environments.options import Range
from core.environments.terms.term import (
    Array,
    Kinds,
    OfAxis,
    OfBody,
    OfBodyContact,
    OfContact,
    OfHeight,
    Term,
)
from core.patterns import PATTERNS, Patterns

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step


class TerminationTerm(Term):
    """`measure` is 1 where it ends the episode, otherwise 0; []."""


TERMINATIONS = Kinds(TerminationTerm, "measure")


class OutsideHeightRange(OfHeight, TerminationTerm):
    """The body is too low or too high."""

    kind: Literal["height_range"] = "height_range"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return 1.0 - self.is_inside(step, model)


class NotUpright(OfAxis, TerminationTerm):
    """The body leans too far."""

    kind: Literal["upright"] = "upright"
    least: float = Field(
        default=0.0,
        ge=-1,
        lt=1,
        description="Least cosine of the axis' angle to the vertical that still counts as upright.",
    )

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.where(self.cosine(step, model) < self.least, 1.0, 0.0)


class Touching(OfContact, TerminationTerm):
    """One of the named geoms touches something."""

    kind: Literal["contact"] = "contact"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.where(self.num_touching(step, model) > 0, 1.0, 0.0)


class IllegalContact(OfBodyContact, TerminationTerm):
    """One of the bodies touches something."""

    kind: Literal["illegal_contact"] = "illegal_contact"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.where(self.num_touching(step, model) > 0, 1.0, 0.0)


class BadOrientation(TerminationTerm):
    """The root's z leans further from the vertical than the angle, in rad."""

    needs = frozenset({"free_root"})

    kind: Literal["bad_orientation"] = "bad_orientation"
    limit_angle: float = Field(default=1.2, gt=0, lt=pi, description="In rad.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.where(-model.projected_gravity(step)[2] < cos(self.limit_angle), 1.0, 0.0)


class OutOfBounds(TerminationTerm):
    """The root is further from where the episode began, measured along the ground, than the distance."""

    remembers = frozenset({"start"})

    kind: Literal["out_of_bounds"] = "out_of_bounds"
    distance: float = Field(gt=0, le=1e6, description="In m.")

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        away = (model.position(step.after, model.root) - step.start)[:2]
        return step.xp.where(step.xp.sum(away**2) > self.distance**2, 1.0, 0.0)


class OutsideJointRange(TerminationTerm):
    """A joint is not inside the range, whose ends are outside."""

    kind: Literal["joint_range"] = "joint_range"
    joints: Patterns = Field(description=f"Hinges and slides. {PATTERNS}")
    range: Range = Field(description="(lowest, highest) in rad or m, or in rad/s or m/s.")
    of: Literal["position", "velocity"] = "position"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        if self.of == "position":
            values = step.after.qpos[step.places(model.joint_positions(self.joints))]
        else:
            values = step.after.qvel[step.places(model.joint_velocities(self.joints))]
        low, high = self.range
        return step.xp.where(step.xp.all((values > low) & (values < high)), 0.0, 1.0)


class FellIntoHole(OfBody, TerminationTerm):
    """The body is lower than all ground that is no hole: it fell between stones, or into a gap."""

    needs = frozenset({"terrain"})

    kind: Literal["fell_into_hole"] = "fell_into_hole"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        height = model.position(step.after, model.body(self.body))[2]
        lowest = 0.0 if step.ground is None else step.ground.lowest
        return step.xp.where(height < lowest, 1.0, 0.0)


_Bound = Annotated[float, Field(gt=0, le=100)] | None


class FarFromReference(TerminationTerm):
    """The body has lost the reference: one of these is further from it than its bound; null: no bound.

    Source for the defaults: mjlab's task `tracking`, and, for the root, track-mjx.
    """

    needs = frozenset({"reference"})

    kind: Literal["far_from_reference"] = "far_from_reference"
    root_position: _Bound = Field(default=0.5, description="The root, in m.")
    root_orientation: _Bound = Field(default=1.0, description="The root's turn, in rad.")
    anchor_height: _Bound = Field(default=0.25, description="How high the anchor is, in m.")
    end_effector_height: _Bound = Field(default=0.25, description="How high any end effector is, in m.")
    joint_position: _Bound = Field(default=None, description="The joints' mean, in rad or m.")
    body_position: _Bound = Field(
        default=None, description="Any compared body's place about the anchor, in m."
    )

    @model_validator(mode="after")
    def _has_a_bound(self) -> Self:
        if not self._bounds:
            raise ValueError("it has no bound, so it would never end an episode: leave it out")
        return self

    @property
    def _bounds(self) -> dict[str, float]:
        fields = type(self).model_fields
        return {name: value for name in fields if name != "kind" and (value := getattr(self, name))}

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        worst = step.xp.stack(
            [self._error(name, step, model) / bound for name, bound in self._bounds.items()]
        )
        return step.xp.where(step.xp.max(worst) > 1.0, 1.0, 0.0)

    def _error(self, name: str, step: "Step", model: "ModelIndex") -> Array:
        xp, followed = step.xp, model.followed
        match name:
            case "root_position":
                return xp.sqrt(xp.sum(followed.root_offset(step) ** 2))
            case "root_orientation":
                return followed.root_turn(step)
            case "anchor_height":
                return abs(followed.anchor_lift(step))
            case "end_effector_height":
                return xp.max(abs(followed.offsets(step, followed.end_effectors)[:, 2]))
            case "joint_position":
                return xp.mean(abs(followed.joint_offsets(step)))
            case _:
                away = followed.offsets(step, followed.compared)
                return xp.sqrt(xp.max(xp.sum(away**2, -1)))


AnyTermination = Annotated[
    OutsideHeightRange
    | OutsideJointRange
    | NotUpright
    | Touching
    | IllegalContact
    | BadOrientation
    | OutOfBounds
    | FellIntoHole
    | FarFromReference,
    TERMINATIONS,
]
