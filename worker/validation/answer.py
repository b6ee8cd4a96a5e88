"""What the confined process is asked, and its answer."""

from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from core.clips.record import ClipsDescription
from core.documents import Stored
from core.user_models.record import Description
from worker.host.disk import read_plain

_MAX_BYTES = 16 * 2**20


class ModelAnswer(Stored):
    """Either what was found, or why the model cannot be used. layers: those of the confinement that held."""

    description: Description | None = None
    refusal: str | None = None
    layers: tuple[str, ...] = ()


class ClipsQuestion(Stored):
    """How to read the file `clips`. body, rate: as of a `ClipFile`; a user's own model is the file `model`.

    name: of a clip that has none in the file.
    """

    body: str
    rate: float | None
    name: str


class ClipsAnswer(Stored):
    """The same about a file of clips."""

    description: ClipsDescription | None = None
    refusal: str | None = None
    layers: tuple[str, ...] = ()


Answer = TypeVar("Answer", ModelAnswer, ClipsAnswer)


def read_answer(path: Path, kind: type[Answer]) -> Answer:
    """The answer in the file; an empty one if it holds none."""
    try:
        return kind.model_validate_json(read_plain(path, _MAX_BYTES))
    except (OSError, ValidationError):
        return kind()
