"""What ends an episode, in a job's words."""

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
        description="Cosine of the axis' angle to the vertical: so much is upright.",
    )


class Touching(OfContact):
    """One of the named geoms touches something."""

    kind: Literal["contact"] = "contact"


TerminationTerm = Annotated[OutsideHeightRange | NotUpright | Touching, Field(discriminator="kind")]
