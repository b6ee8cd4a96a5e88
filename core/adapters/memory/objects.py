"""Objects in this process' memory."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from typing import IO

from core.adapters.s3.keys import PIECE_BYTES, check_readable, check_writable
from core.errors import ObjectDamaged, ObjectNotFound
from core.storage.objects import ObjectInfo


def _utc_now() -> datetime:
    return datetime.now(UTC)


class MemoryObjectStore:
    """An ObjectStore for one process; thread-safe."""

    def __init__(self, clock: Callable[[], datetime] = _utc_now) -> None:
        self._objects: dict[str, tuple[bytes, str, datetime]] = {}
        self._lock = Lock()
        self._clock = clock

    def put(self, key: str, body: bytes, *, media_type: str = "application/octet-stream") -> None:
        with self._lock:
            self._objects[check_writable(key)] = (bytes(body), media_type, self._clock())

    def put_file(self, key: str, path: Path, *, media_type: str = "application/octet-stream") -> None:
        self.put(check_writable(key), path.read_bytes(), media_type=media_type)

    def put_stream(
        self, key: str, stream: IO[bytes], size: int, *, media_type: str = "application/octet-stream"
    ) -> None:
        self.put(check_writable(key), stream.read(size), media_type=media_type)

    def get(self, key: str) -> bytes:
        return self._found(key)[0]

    def open(
        self, key: str, start: int = 0, length: int | None = None, *, size: int | None = None
    ) -> AbstractContextManager[Iterator[bytes]]:
        body = self._found(key)[0]
        if size not in (None, len(body)):
            raise ObjectDamaged(key, f"it has {len(body):,} bytes instead of {size:,}")
        end = len(body) if length is None else min(len(body), start + length)
        return nullcontext(body[i : min(end, i + PIECE_BYTES)] for i in range(start, end, PIECE_BYTES))

    def info(self, key: str) -> ObjectInfo:
        body, media_type, modified_at = self._found(key)
        return ObjectInfo(key, len(body), media_type, modified_at=modified_at)

    def list(self, prefix: str) -> Iterator[ObjectInfo]:
        with self._lock:
            found = [
                ObjectInfo(key, len(body), modified_at=modified_at)
                for key, (body, _, modified_at) in self._objects.items()
                if key.startswith(prefix)
            ]
        return iter(sorted(found, key=lambda info: info.key))

    def delete_prefix(self, prefix: str) -> None:
        with self._lock:
            for key in [key for key in self._objects if key.startswith(prefix)]:
                del self._objects[key]

    def end_uploads(self, prefix: str, before: datetime) -> int:
        return 0  # A put is one step here.

    def _found(self, key: str) -> tuple[bytes, str, datetime]:
        with self._lock:
            found = self._objects.get(check_readable(key))
        if found is None:
            raise ObjectNotFound(key)
        return found
