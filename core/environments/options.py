"""Kinds of values that the options of several environments have."""

from typing import Annotated

from pydantic import AfterValidator, Field


def _ascending(bounds: tuple[float, float | None]) -> tuple[float, float | None]:
    low, high = bounds
    if high is not None and low >= high:
        raise ValueError(f"must be [low, high] with low < high, not [{low:g}, {high:g}]")
    return bounds


_FROM_A_LIST = Field(strict=False)  # JSON has no tuples

Range = Annotated[tuple[float, float], _FROM_A_LIST, AfterValidator(_ascending)]
"""[low, high], low < high."""

OpenRange = Annotated[tuple[float, float | None], _FROM_A_LIST, AfterValidator(_ascending)]
"""[low, high], low < high; `null` above means no bound."""

Weight = Annotated[float, Field(ge=-1e6, le=1e6)]
NoiseScale = Annotated[float, Field(ge=0, le=10)]
