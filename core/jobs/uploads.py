"""The files that users sent and that jobs name."""

from collections.abc import Iterator, Mapping
from typing import Protocol, cast

from core.clips.record import ClipStore
from core.jobs.spec import EnvironmentSpec
from core.user_models.record import ModelStore


class Uploads(Protocol):
    """The records of the files that users send."""

    @property
    def models(self) -> ModelStore:
        """Of users' own models."""
        ...

    @property
    def clips(self) -> ClipStore:
        """Of clip files."""
        ...


def clip_files_of(environment: EnvironmentSpec) -> tuple[str, ...]:
    """The ids of the clip files that an environment's options name, each once.

    The options may be wrong: they are read as far as they can be.
    """
    return tuple(dict.fromkeys(file for _, file in named_clips(environment)))


def named_clips(environment: EnvironmentSpec) -> Iterator[tuple[int, str]]:
    """The place of each choice of clips among the options, and the id of its file."""
    choices = _member(environment.options.get("reference"), "clips")
    for place, choice in enumerate(cast("list[object]", choices) if isinstance(choices, list) else ()):
        if isinstance(file := _member(choice, "file"), str):
            yield place, file


def _member(document: object, name: str) -> object:
    return cast("Mapping[str, object]", document).get(name) if isinstance(document, Mapping) else None
