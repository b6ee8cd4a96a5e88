"""Fields that several kinds of terms share; imports no numerical code."""

from typing import Annotated

from pydantic import AfterValidator, Field

from core.bounds import LONGEST_NAME, Real
from core.documents import Strict
from core.environments.options import Range

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
