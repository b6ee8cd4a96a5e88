"""Which clips a job takes, and how it changes them: parts of its specification. No numerical code."""

from collections.abc import Sequence
from itertools import chain, count
from typing import Annotated

from pydantic import Field, model_validator

from core.documents import Strict
from core.patterns import PATTERNS, Patterns

ClipFileId = Annotated[
    str, Field(pattern=r"^sha256:[0-9a-f]{64}$", description="The id that `POST /clips` returned.")
]
# Of a clip, in seconds: a day.
_LONGEST_S = 86_400.0
Moment = Annotated[float, Field(ge=0, le=_LONGEST_S)]


class ClipChoice(Strict):
    """Clips of one file, and what is changed in each: it is cut first, then mirrored, then sped up."""

    file: ClipFileId
    names: Patterns | None = Field(None, description=f"Which of the file's clips; null takes all. {PATTERNS}")
    weight: float = Field(
        1.0, gt=0, le=1e6, description="How often each of these clips is taken beside the others."
    )
    from_s: Moment = Field(0.0, description="Where the clip begins, in seconds of the recording.")
    to_s: Moment | None = Field(None, description="Where it ends; null: where the recording ends.")
    mirror: bool = Field(False, description="Left and right are exchanged; the body must be symmetric.")
    speed: float = Field(1.0, ge=0.1, le=10, description="2 plays the clip twice as fast.")

    @model_validator(mode="after")
    def _has_an_extent(self) -> "ClipChoice":
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError(f"to_s = {self.to_s:g} must be greater than from_s = {self.from_s:g}")
        return self


def called(name: str, choice: ClipChoice) -> str:
    """The name that a clip has in a job with this choice."""
    mirror = " mirrored" if choice.mirror else ""
    return name + mirror + ("" if choice.speed == 1.0 else f" x{choice.speed:g}")


def distinct(names: Sequence[str]) -> list[str]:
    """The names, with a number after those that were there before."""
    found = dict[str, None]()
    for name in names:
        candidates = chain([name], (f"{name} {number}" for number in count(2)))
        found[next(one for one in candidates if one not in found)] = None
    return list(found)
