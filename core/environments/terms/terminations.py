"""The terms that end an episode."""

from math import cos, pi
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

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


AnyTermination = Annotated[
    OutsideHeightRange
    | OutsideJointRange
    | NotUpright
    | Touching
    | IllegalContact
    | BadOrientation
    | OutOfBounds
    | FellIntoHole,
    TERMINATIONS,
]
