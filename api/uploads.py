"""An uploaded file: it is hashed and written to disk as it arrives, but not parsed."""

import hashlib
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import NamedTemporaryFile

from anyio import fail_after
from fastapi import Request

from api.submissions import pieces_of
from core.errors import Rejected, StorageUnavailable

_BEGINNING = 8
# A machine that sleeps in the middle of its upload closes no connection.
_LONGEST_PAUSE_S = 60.0


@dataclass(frozen=True)
class Upload:
    """path: exists until the request ends. beginning: the first bytes."""

    path: Path
    sha256: str
    size: int
    beginning: bytes


@asynccontextmanager
async def receiving(request: Request, limit: int) -> AsyncGenerator[Upload]:
    """The whole body in a file.

    Raises BodyTooLarge; Rejected where it stops coming; StorageUnavailable where this machine has no room.
    """
    digest, size, beginning = hashlib.sha256(), 0, b""
    with NamedTemporaryFile(prefix="gaitway-upload-") as file:
        try:
            async for piece in _without_pauses(pieces_of(request, limit)):
                file.write(piece)
                digest.update(piece)
                size += len(piece)
                beginning = (beginning + piece)[:_BEGINNING]
            file.flush()
        except OSError as error:
            raise StorageUnavailable(f"The API has no room for the upload: {error.strerror}.") from error
        yield Upload(Path(file.name), digest.hexdigest(), size, beginning)


async def _without_pauses(pieces: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    while True:
        try:
            with fail_after(_LONGEST_PAUSE_S):
                piece = await anext(pieces, None)
        except TimeoutError:
            raise Rejected(f"The body of the request stopped coming for {_LONGEST_PAUSE_S:.0f} s.") from None
        if piece is None:
            return
        yield piece
