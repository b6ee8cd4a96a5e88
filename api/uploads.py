"""An uploaded file: it is hashed and written to disk as it arrives, but not parsed."""

import hashlib
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import NamedTemporaryFile

from fastapi import Request

from api.submissions import pieces_of
from core.errors import StorageUnavailable

_BEGINNING = 8


@dataclass(frozen=True)
class Upload:
    """path: exists until the request ends. beginning: the first bytes."""

    path: Path
    sha256: str
    size: int
    beginning: bytes


@asynccontextmanager
async def receiving(request: Request, limit: int) -> AsyncGenerator[Upload]:
    """The whole body in a file. Raises BodyTooLarge; StorageUnavailable where this machine has no room."""
    digest, size, beginning = hashlib.sha256(), 0, b""
    with NamedTemporaryFile(prefix="gaitway-upload-") as file:
        try:
            async for piece in pieces_of(request, limit):
                file.write(piece)
                digest.update(piece)
                size += len(piece)
                beginning = (beginning + piece)[:_BEGINNING]
            file.flush()
        except OSError as error:
            raise StorageUnavailable(f"The API has no room for the upload: {error.strerror}.") from error
        yield Upload(Path(file.name), digest.hexdigest(), size, beginning)
