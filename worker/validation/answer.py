"""What the confined process says."""

import os
import stat
from pathlib import Path

from pydantic import ValidationError

from core.documents import Stored
from core.user_models.record import Description

_MOST_BYTES = 16 * 2**20


class Answer(Stored):
    """Either what was found, or why the model cannot be used. layers: of the confinement it was found in."""

    description: Description | None = None
    refusal: str | None = None
    layers: tuple[str, ...] = ()


def read_answer(path: Path) -> Answer:
    """What the file says; nothing, where that is no answer."""
    try:
        return Answer.model_validate_json(read_plain(path, _MOST_BYTES))
    except (OSError, ValidationError):
        return Answer()


def read_plain(path: Path, most_bytes: int) -> bytes:
    """The file's end. Who wrote it may have been taken over: no link is followed, no pipe waited for.

    Raises OSError.
    """
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise OSError(f"{path.name} is no file.")
        file.seek(max(0, found.st_size - most_bytes))
        return file.read(most_bytes)
