"""The response for an artifact: streamed in pieces, with ETag, byte ranges and a safe media type.

Ranges are those of RFC 9110, sections 13 and 14.
"""

import hashlib
import re
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

import anyio
import structlog
from anyio import to_thread
from fastapi import Request, Response
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from api.dependencies import Service
from api.problems import RangeNotSatisfiable, refusals
from core.errors import (
    ArtifactNotFound,
    ArtifactNotReady,
    JobNotFound,
    JobUnreadable,
    NotFound,
    ObjectDamaged,
    ObjectNotFound,
    RecordsUnavailable,
    StorageUnavailable,
)
from core.jobs.job import Artifact
from core.storage.objects import OTHER_BYTES, check_whole, read_whole

_ONE_RANGE = re.compile(r"bytes=[ \t]*(\d{0,19})-(\d{0,19})[ \t]*", re.ASCII | re.IGNORECASE)
log = structlog.get_logger()
# A file up to this size is read before its answer begins.
_READ_FIRST_BYTES = 2 * 2**20
_MOST_BROKEN_KEPT = 1000


@dataclass(frozen=True)
class ByteRange:
    """Bytes [start, start + length) of `size`."""

    start: int
    length: int
    size: int

    @property
    def content_range(self) -> str:
        return f"bytes {self.start}-{self.start + self.length - 1}/{self.size}"


def requested_range(headers: Mapping[str, str], size: int, etag: str) -> ByteRange | None:
    """The range to send, or None for the whole file: the request has no range, several, an invalid one, or
    one of another version (If-Range). Raises RangeNotSatisfiable where the range begins past the end."""
    found = _ONE_RANGE.fullmatch(headers.get("range", ""))
    if found is None or found[0] == "bytes=-" or headers.get("if-range", etag) != etag:
        return None
    first, last = found[1], found[2]
    if not first:
        return _suffix(int(last), size) if last else None
    start = int(first)
    if last and int(last) < start:
        return None
    if start >= size:
        raise RangeNotSatisfiable(size)
    end = min(int(last), size - 1) if last else size - 1
    return ByteRange(start, end - start + 1, size)


def is_known(headers: Mapping[str, str], etag: str) -> bool:
    """Whether the client has this version already (If-None-Match; weak comparison)."""
    known = [tag.strip().removeprefix("W/") for tag in headers.get("if-none-match", "").split(",")]
    return etag in known or known == ["*"]


def _suffix(length: int, size: int) -> ByteRange:
    if not length or not size:
        raise RangeNotSatisfiable(size)
    length = min(length, size)
    return ByteRange(size - length, length, size)


def responses(media_type: str, missing: type[NotFound] = JobNotFound) -> dict[int | str, dict[str, Any]]:
    """The responses of a route that serves files of this media type, `*/*` for any.

    missing: for an owner that does not exist."""
    content = {media_type: {"schema": {"type": "string", "format": "binary"}}}
    return {
        200: {"description": "The whole file", "content": content},
        206: {"description": "The bytes that `Range` names", "content": content},
        304: {"description": "The client has this version: `If-None-Match` names its ETag"},
        **refusals(
            missing,
            ArtifactNotFound,
            ArtifactNotReady,
            JobUnreadable,
            ObjectNotFound,
            ObjectDamaged,
            RangeNotSatisfiable,
            RecordsUnavailable,
            StorageUnavailable,
        ),
    }


class PiecesResponse(StreamingResponse):
    """Streams an open object, and closes it at the end or when the client disconnects."""

    def __init__(
        self, pieces: Iterator[bytes], opened: ExitStack, status: int, headers: dict[str, str]
    ) -> None:
        super().__init__(_in_threads(pieces), status, headers)
        self._opened = opened

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        except (ObjectNotFound, StorageUnavailable) as error:
            # The server then closes the connection, so that nobody takes what was sent for the whole.
            log.error("answer_broken_off", path=scope["path"], error=error.detail)
        finally:
            with anyio.CancelScope(shield=True):
                await to_thread.run_sync(self._opened.close)


def file_response(request: Request, artifact: Artifact, service: Service) -> Response:
    """The file, the range that was asked for, or 304 if the client has this version.

    A whole file has the recorded hash: the answer breaks off before the end of one that turns out not to, and
    later requests are told so. Raises RangeNotSatisfiable, ObjectNotFound, ObjectDamaged, StorageUnavailable.
    """
    etag = f'"{artifact.sha256}"'
    headers = _headers(artifact, etag)
    if is_known(request.headers, etag):
        return Response(status_code=304, headers=headers)
    wanted = requested_range(request.headers, artifact.size, etag) if request.method == "GET" else None
    part = wanted or ByteRange(0, artifact.size, artifact.size)
    headers["Content-Length"] = str(part.length)
    headers["Content-Type"] = _media_type(artifact)
    if wanted is not None:
        headers["Content-Range"] = wanted.content_range
    if request.method == "HEAD" or not part.length:
        return Response(status_code=200, headers=headers)
    status = 206 if wanted else 200
    if part.length == artifact.size <= _READ_FIRST_BYTES:
        return Response(read_whole(artifact.key, artifact.sha256, service.objects), status, headers)
    if artifact.key in service.broken_files:
        check_whole(artifact.key, artifact.sha256, service.objects)
        service.broken_files.discard(artifact.key)
    opened = ExitStack()
    pieces = opened.enter_context(
        service.objects.open(artifact.key, part.start, part.length, size=artifact.size)
    )
    checked = _checked(pieces, artifact, part.length == artifact.size, service)
    return PiecesResponse(checked, opened, status, headers)


def _checked(pieces: Iterator[bytes], artifact: Artifact, is_all: bool, service: Service) -> Iterator[bytes]:
    """The pieces; of a whole file the last one only if all have the recorded hash."""
    held, digest = b"", hashlib.sha256()
    try:
        for piece in pieces:
            if held:
                yield held
            held = piece
            digest.update(piece)
        if is_all and digest.hexdigest() != artifact.sha256:
            raise ObjectDamaged(artifact.key, OTHER_BYTES)
    except (ObjectDamaged, StorageUnavailable):
        if len(service.broken_files) >= _MOST_BROKEN_KEPT:
            service.broken_files.clear()
        service.broken_files.add(artifact.key)
        raise
    yield held


def _headers(artifact: Artifact, etag: str) -> dict[str, str]:
    return {
        "ETag": etag,
        "Accept-Ranges": "bytes",
        "Cache-Control": "private, no-cache",
        "Content-Disposition": f"inline; filename*=UTF-8''{quote(artifact.name, safe='')}",
        "Content-Security-Policy": "sandbox",
        "X-Content-Type-Options": "nosniff",
    }


def _media_type(artifact: Artifact) -> str:
    """The stored media type; for text always text/plain in UTF-8, so that a browser runs none of it."""
    if artifact.role == "log" or artifact.media_type.startswith("text/"):
        return "text/plain; charset=utf-8"
    return artifact.media_type


async def _in_threads(pieces: Iterator[bytes]) -> AsyncIterator[bytes]:
    while (piece := await to_thread.run_sync(next, pieces, None)) is not None:
        yield piece
