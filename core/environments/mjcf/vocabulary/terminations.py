"""The termination terms of a job."""

from typing import Annotated, Literal

from pydantic import Field

from core.environments.mjcf.vocabulary.parts import OfAxis, OfContact, OfHeight


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
