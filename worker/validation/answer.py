"""The answer of the confined process."""

from pathlib import Path

from pydantic import ValidationError

from core.documents import Stored
from core.user_models.record import Description
from worker.host.disk import read_plain

_MAX_BYTES = 16 * 2**20


class ModelAnswer(Stored):
    """Either what was found, or why the model cannot be used. layers: those of the confinement that held."""

    description: Description | None = None
    refusal: str | None = None
    layers: tuple[str, ...] = ()


def read_answer(path: Path) -> ModelAnswer:
    """The answer in the file; an empty one if it holds none."""
    try:
        return ModelAnswer.model_validate_json(read_plain(path, _MAX_BYTES))
    except (OSError, ValidationError):
        return ModelAnswer()
