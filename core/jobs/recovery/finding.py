"""The findings of `gaitway recover`, and the objects of the bucket by size."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from core.jobs.job import Artifact
from core.storage.objects import ObjectInfo

Remedy = Literal["adopt", "mark"]
Sizes = Mapping[str, int]


def _do_nothing() -> None:
    pass


@dataclass(frozen=True)
class Finding:
    """Something on which the record and the bucket disagree.

    remedy: what the user has to ask for before `act` is called; None if nothing can be done.
    act: applies the remedy; raises NotFound or Conflict if something has changed meanwhile.
    """

    sentence: str
    remedy: Remedy | None = None
    act: Callable[[], None] = _do_nothing


def sizes_of(infos: Iterator[ObjectInfo] | Sequence[ObjectInfo]) -> Sizes:
    return {info.key: info.size for info in infos}


def is_there(artifact: Artifact, sizes: Sizes) -> bool:
    return sizes.get(artifact.key) == artifact.size
