"""Users' models for tests that have no API to send them to."""

import hashlib
from datetime import datetime
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from core.uploads import library
from core.user_models.record import ModelRecord


def identity(body: bytes) -> str:
    """The id of a model whose file has these bytes."""
    return f"sha256:{hashlib.sha256(body).hexdigest()}"


def add(
    body: bytes, media_type: str = "application/xml", *, now: datetime, name: str | None = None, **where: Any
) -> ModelRecord:
    """As the API does once it has received them."""
    with NamedTemporaryFile() as file:
        file.write(body)
        file.flush()
        record = ModelRecord(
            id=identity(body),
            name=name,
            status="validating",
            media_type=media_type,
            size=len(body),
            created_at=now,
        )
        return library.add(Path(file.name), record, **where)
