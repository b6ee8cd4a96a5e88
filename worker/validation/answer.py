"""The answer of the confined process."""

import os
import stat
from pathlib import Path

from pydantic import ValidationError

from core.documents import Stored
from core.user_models.record import Description

_MAX_BYTES = 16 * 2**20


class Answer(Stored):
    """Either what was found, or why the model cannot be used. layers: those of the confinement that held."""

    description: Description | None = None
    refusal: str | None = None
    layers: tuple[str, ...] = ()


def read_answer(path: Path) -> Answer:
    """The answer in the file; an empty one if it holds none."""
    try:
        return Answer.model_validate_json(read_plain(path, _MAX_BYTES))
    except (OSError, ValidationError):
        return Answer()


def read_plain(path: Path, most_bytes: int) -> bytes:
    """The end of a file whose writer may have been taken over: follows no link and waits for no pipe.

    Raises OSError.
    """
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise OSError(f"{path.name} is not a regular file.")
        file.seek(max(0, found.st_size - most_bytes))
        return file.read(most_bytes)
