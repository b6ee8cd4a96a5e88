"""A request for stills, the stills that a worker rendered, and the queue that brings requests to workers."""

import hashlib
import json
from importlib.metadata import version
from typing import Protocol

from pydantic import JsonValue

from core.documents import Stored
from core.rendering.request import Overlay, RenderFailure

# Raise it with every change of how a scene looks, so that no outdated still is shown.
_SCENE_VERSION = 2


class PreviewRequest(Stored):
    """An environment as an episode begins, seen by these cameras: everything that a still depends on.

    options: all of them, defaults filled in. model: the id of the user's own model that they name.
    clips: the files of clips that they name, each with the hash of what a worker read in it.
    show: what is drawn besides the body. width, height: pixels.
    """

    environment: str
    options: dict[str, JsonValue]
    model: str | None = None
    clips: dict[str, str] = {}
    cameras: list[str | int]
    show: list[Overlay] = []
    width: int
    height: int

    @property
    def id(self) -> str:
        """Equal for requests with equal stills."""
        parts = [_SCENE_VERSION, version("gaitway"), self.model_dump(mode="json")]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()

    @property
    def subject(self) -> str:
        """The subject of the stills: a user's model, or an environment."""
        return self.model or self.environment


class Still(Stored):
    """A PNG from one camera. key: in the object store; size: bytes."""

    camera: str | int
    key: str
    size: int
    sha256: str


class Preview(Stored):
    """Stills in the request's order of cameras; or why there are none."""

    stills: list[Still] = []
    failure: RenderFailure | None = None


class PreviewQueue(Protocol):
    """At-least-once; every method raises RecordsUnavailable when the queue cannot be reached."""

    def enqueue_preview(self, request: PreviewRequest) -> None:
        """Let any worker render the stills, before all jobs. Doing so twice changes nothing."""
        ...

    def contains_preview(self, preview_id: str) -> bool:
        """Whether it waits, or a worker is rendering it."""
        ...

    def num_previews(self) -> int:
        """How many wait for a worker."""
        ...
