"""What the confined process is asked, and its answer."""

import os
import re
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from core.clips.record import ClipsDescription
from core.documents import Stored
from core.user_models.record import Description
from worker.host.disk import read_plain

_MAX_BYTES = 16 * 2**20
# How far the process is with key points: `<frame> <number of frames>`.
_PROGRESS, _LONGEST_PROGRESS = "progress", 100
_AT = re.compile(rb"(\d{1,9}) (\d{1,9})")


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


def write_progress(folder: Path, frame: int, num_frames: int) -> None:
    """Leave word of how far the process is."""
    part = folder / f"{_PROGRESS}.part"
    part.write_text(f"{frame} {num_frames}")
    os.replace(part, folder / _PROGRESS)


def read_progress(folder: Path) -> str | None:
    """A sentence on how far the process is; None where it has not said so."""
    try:
        at = _AT.fullmatch(read_plain(folder / _PROGRESS, _LONGEST_PROGRESS))
    except OSError:
        return None
    return None if at is None else f"Fitting frame {int(at[1]):,} of {int(at[2]):,}."
