"""The terms that end an episode."""

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from core.environments.numbers import Ends, NotSimulated, numbers
from core.environments.terms.term import Array, OfAxis, OfContact, OfHeight, Term

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step


class TerminationTerm(Term):
    """`measure` is 1 where it ends the episode, otherwise 0; []."""

    def ends(self, model: "ModelIndex") -> Ends:
        """The term as bounds on MuJoCo's numbers. Raises NotSimulated where it is none."""
        raise NotSimulated("an episode ends by what only the training computes")


class OutsideHeightRange(OfHeight, TerminationTerm):
    """The body is too low or too high."""

    kind: Literal["height_range"] = "height_range"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return 1.0 - self.is_inside(step, model)

    def ends(self, model: "ModelIndex") -> Ends:
        body = model.body(self.body)
        start = model.free_joint(body)
        height = numbers("xpos", [3 * body + 2]) if start is None else numbers("qpos", [start + 2])
        return Ends(height, *self.range)


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

    def ends(self, model: "ModelIndex") -> Ends:
        if self.axis[:2] != (0.0, 0.0) or self.axis[2] <= 0:
            raise NotSimulated("an episode ends by an axis that is not the body's z")
        return Ends(numbers("xmat", [9 * model.body(self.body) + 8]), self.least, None)


class Touching(OfContact, TerminationTerm):
    """One of the named geoms touches something."""

    kind: Literal["contact"] = "contact"

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        return step.xp.where(self.num_touching(step, model) > 0, 1.0, 0.0)

    def ends(self, model: "ModelIndex") -> Ends:
        return Ends(numbers("sensordata", model.contacts(self.geoms, self.against).tolist()), None, 0.5)


AnyTermination = Annotated[OutsideHeightRange | NotUpright | Touching, Field(discriminator="kind")]
