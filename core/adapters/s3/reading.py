"""One object's bytes, asked for again where they do not come; and which is to blame, the object or the store.

An object that cannot be read at several tries, while after each of them another object is read, is damaged. A
store that gives nothing at all is unavailable. SeaweedFS, for one, answers each GET of an object whose bytes
do not have its checksum with an error, after 13 s, and serves everything else.
"""

import hashlib
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from threading import Thread

import structlog
from minio import Minio
from minio.error import S3Error
from urllib3.exceptions import HTTPError
from urllib3.response import BaseHTTPResponse

from core.adapters.s3.connection import waiting
from core.adapters.s3.errors import is_of_one_object, reaching_s3
from core.adapters.s3.keys import PIECE_BYTES
from core.errors import ObjectDamaged, ObjectNotFound, StorageRefuses, StorageUnavailable

log = structlog.get_logger()

# How long each try waits for the next bytes. Together they bound what a damaged object costs its reader.
_PATIENCE_S = (2.0, 3.0, 4.0)
# Where the store is slow: an object gets so many times as long as another one has just taken.
_TIMES_ANOTHER = 4.0
# Bytes that come more slowly than this, in the long run, come too slowly.
_LEAST_BYTES_PER_S = 128 * 1024
_PAUSE_S, _LONGEST_PROBE_S = 0.1, 20.0
PROBE = "probe"
# Long enough that a connection which flips bits flips one of these; without a pattern, not compressible.
_PROBE_BODY = hashlib.shake_256(PROBE.encode()).digest(16 * 1024)


@dataclass
class Reading:
    """Bytes [start, end) of an object. end: None for the object's. size: that it must have, if any.

    Raises, from `begin` and while the pieces are read: ObjectNotFound, ObjectDamaged, StorageUnavailable.
    """

    client: Minio
    bucket: str
    key: str
    at: int
    end: int | None
    size: int | None = None
    _response: BaseHTTPResponse | None = None
    _etag: str | None = None
    _patience_s: float = _PATIENCE_S[0]
    _failures: list[str] = field(default_factory=list[str])

    def begin(self) -> None:
        """Ask until there is an answer."""
        self._insist(self._ask)

    def pieces(self) -> Iterator[bytes]:
        """The remaining bytes, in pieces of at most 1 MiB."""
        while self.at != self.end and (piece := self._insist(self._next)):
            yield piece

    def close(self) -> None:
        if self._response is not None:
            self._response.close()
            self._response.release_conn()
            self._response = None

    def _insist(self, step: Callable[[], bytes]) -> bytes:
        while True:
            try:
                with reaching_s3(self.bucket, self.key):
                    return step()
            except StorageRefuses:
                raise
            except StorageUnavailable as error:
                self.close()
                self._judge(error)

    def _judge(self, error: StorageUnavailable) -> None:
        """Return if another try is due. Raises ObjectDamaged, or the error if the store is to blame."""
        took_s = _time_of_another(self.client, self.bucket)
        if took_s is None or not is_of_one_object(error):
            raise error
        self._failures.append(error.detail)
        log.warning("object_not_read", key=self.key, tries=len(self._failures), error=error.detail)
        if len(self._failures) == len(_PATIENCE_S):
            raise ObjectDamaged(self.key, "the object store does not give its bytes, while it gives others")
        self._patience_s = max(_PATIENCE_S[len(self._failures)], _TIMES_ANOTHER * took_s)
        time.sleep(_PAUSE_S)

    def _ask(self) -> bytes:
        length = 0 if self.end is None else self.end - self.at

        def get() -> BaseHTTPResponse:
            with waiting(self._patience_s):
                return self.client.get_object(self.bucket, self.key, offset=self.at, length=length)

        try:
            response = _within(self._patience_s + 0.5, get)
        except S3Error as error:
            if error.code != "InvalidRange":
                raise
            self.end = self.at  # It starts at or after the end of the object.
            return b""
        self._response = response
        self._check_size(_whole_size(response))
        etag = response.headers.get("ETag")
        if self._etag not in (None, etag):
            raise StorageUnavailable(f"The object {self.key!r} was replaced while it was read.")
        self._etag = etag
        return b""

    def _check_size(self, found: int | None) -> None:
        if self.size is not None and found is not None and found != self.size:
            self.close()
            raise ObjectDamaged(self.key, f"it has {found:,} bytes instead of {self.size:,}")

    def _next(self) -> bytes:
        """The next bytes, up to a whole piece; none at the end. What breaks off is asked for again."""
        if self._response is None:
            self._ask()
        response, piece, waited_s = self._response, bytearray(), 0.0
        while response is not None and len(piece) < PIECE_BYTES:
            began = time.monotonic()
            some = response.read1(PIECE_BYTES - len(piece))
            waited_s += time.monotonic() - began
            if not some:
                break
            piece += some
            if waited_s > self._patience_s + len(piece) / _LEAST_BYTES_PER_S:
                raise HTTPError(f"{len(piece):,} bytes came in {waited_s:.0f} s")
        self.at += len(piece)
        if len(piece) == PIECE_BYTES:
            self._failures.clear()
        return bytes(piece)


def _within(seconds: float, get: Callable[[], BaseHTTPResponse]) -> BaseHTTPResponse:
    """The answer; one whose headers come a byte now and then, which no socket's timeout ends, is given up."""
    answer = Future[BaseHTTPResponse]()

    def run() -> None:
        try:
            answer.set_result(get())
        except BaseException as error:
            answer.set_exception(error)

    Thread(target=run, name="get", daemon=True).start()
    if not wait([answer], seconds).done:
        answer.add_done_callback(_close)
        raise HTTPError(f"no whole answer in {seconds:g} s")
    return answer.result()


def _close(answer: Future[BaseHTTPResponse]) -> None:
    if answer.exception() is None:
        answer.result().close()


def _whole_size(response: BaseHTTPResponse) -> int | None:
    """That of the whole object, as the answer says it."""
    length = response.headers.get("Content-Range", "").rpartition("/")[2]
    length = length if response.status == 206 else response.headers.get("Content-Length", "")
    return int(length) if length.isdigit() else None


def _time_of_another(client: Minio, bucket: str) -> float | None:
    """How many seconds it takes to read another object; None if that cannot be read either."""
    with suppress(StorageUnavailable, ObjectNotFound):
        try:
            began = time.monotonic()
            is_whole = _probe(client, bucket) == _PROBE_BODY
            took_s = time.monotonic() - began
        except ObjectNotFound:
            is_whole, took_s = False, 0.0
        if not is_whole:  # Nobody has needed it yet, or it is damaged itself.
            began = time.monotonic()
            with reaching_s3(bucket, PROBE):
                client.put_object(bucket, PROBE, BytesIO(_PROBE_BODY), len(_PROBE_BODY))
            is_whole = _probe(client, bucket) == _PROBE_BODY
            took_s = time.monotonic() - began
        return took_s if is_whole else None
    return None


def _probe(client: Minio, bucket: str) -> bytes:
    with reaching_s3(bucket, PROBE):
        response = _within(_LONGEST_PROBE_S, lambda: client.get_object(bucket, PROBE))
        try:
            return response.read()
        finally:
            response.close()
            response.release_conn()
