"""What the confined process says."""

from core.model import Stored
from core.models.record import Description


class Answer(Stored):
    """Either what was found, or why the model cannot be used."""

    description: Description | None = None
    refusal: str | None = None
