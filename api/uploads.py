"""An uploaded file: it is hashed and written to disk as it arrives, but not parsed."""

import hashlib
import time
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import NamedTemporaryFile

from anyio import fail_after
from fastapi import Request

from api.submissions import pieces_of
from core.errors import Rejected, StorageUnavailable

_BEGINNING = 8
# The end of a zip's directory with the longest comment.
_END = 22 + 2**16 - 1
# A machine that sleeps in the middle of its upload closes no connection.
_LONGEST_PAUSE_S = 60.0
# After the first minute: an upload holds one of few places.
_SLOWEST_BYTES_PER_S = 2**16


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

    Raises BodyTooLarge; Rejected where it stops coming or comes too slowly; StorageUnavailable where this
    machine has no room.
    """
    digest, size, beginning = hashlib.sha256(), 0, b""
    with NamedTemporaryFile(prefix="gaitway-upload-") as file:
        try:
            began = time.monotonic()
            async for piece in _without_pauses(pieces_of(request, limit)):
                _check_pace(size, time.monotonic() - began)
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


def _check_pace(size: int, seconds: float) -> None:
    """Raises Rejected. size: bytes that have come until now."""
    if seconds > _LONGEST_PAUSE_S + size / _SLOWEST_BYTES_PER_S:
        raise Rejected(
            f"The body of the request came too slowly: {size:,} bytes in {seconds:.0f} s. After the first "
            f"{_LONGEST_PAUSE_S:.0f} s it may take a second for each {_SLOWEST_BYTES_PER_S:,} bytes."
        )


def with_end(upload: Upload, changed: Callable[[bytes], bytes | None]) -> Upload | None:
    """The upload with another end, in its own file; None if `changed` makes none of the last bytes."""
    with upload.path.open("r+b") as file:
        file.seek(max(0, upload.size - _END))
        at, end = file.tell(), changed(file.read())
        if end is None:
            return None
        file.seek(at)
        file.truncate()
        file.write(end)
        file.seek(0)
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return replace(upload, sha256=sha256, size=at + len(end))
