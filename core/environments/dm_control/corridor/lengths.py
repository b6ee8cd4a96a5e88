"""The type of an option that gives the bounds of lengths."""

from typing import Annotated

from pydantic import AfterValidator, Field

from core.bounds import Real


def _not_descending(bounds: tuple[float, float]) -> tuple[float, float]:
    low, high = bounds
    if low > high:
        raise ValueError(f"[{low:g}, {high:g}] is not [low, high] with low ≤ high")
    if low < 0:
        raise ValueError(f"must not be negative, but [{low:g}, {high:g}] is")
    return bounds


Drawn = Annotated[tuple[Real, Real], Field(strict=False), AfterValidator(_not_descending)]
"""[low, high] in metres: each length is drawn uniformly between them."""
