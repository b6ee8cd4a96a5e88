"""An object store and a job queue in this process' memory: they pass the contracts of the real ones."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from typing import IO

from core.adapters.s3.keys import PIECE_BYTES, check_readable, check_writable
from core.errors import ObjectDamaged, ObjectNotFound
from core.jobs.queue import queue_names
from core.previews.record import PreviewRequest
from core.storage.objects import ObjectInfo
from core.uploads.record import KindName


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

    def delete(self, keys: Iterable[str]) -> None:
        with self._lock:
            for key in keys:
                self._objects.pop(key, None)

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


@dataclass(frozen=True)
class Dispatch:
    """One attempt on its way to a worker."""

    job_id: str
    attempt: int


class MemoryJobQueue:
    """A JobQueue for one process; thread-safe. Its messages can be inspected and taken."""

    def __init__(self) -> None:
        self._waiting: dict[Dispatch, str] = {}
        self._taken: set[Dispatch] = set()
        self._uploads: list[tuple[KindName, str]] = []
        self._previews: list[PreviewRequest] = []
        self._lock = Lock()

    def enqueue(self, job_id: str, attempt: int, *, name: str, again: bool = False) -> None:
        dispatch = Dispatch(job_id, attempt)
        with self._lock:
            if again or dispatch not in self._taken:
                self._waiting.setdefault(dispatch, name)

    def num_waiting(self, names: Collection[str]) -> Mapping[str, int]:
        with self._lock:
            waiting = Counter(self._waiting.values())
            return {name: waiting[name] for name in names}

    def contains(self, job_id: str, attempt: int) -> bool:
        dispatch = Dispatch(job_id, attempt)
        with self._lock:
            return dispatch in self._waiting or dispatch in self._taken

    def known(self) -> Collection[tuple[str, int]]:
        with self._lock:
            return {(dispatch.job_id, dispatch.attempt) for dispatch in (*self._waiting, *self._taken)}

    def taken(self) -> Collection[tuple[str, int]]:
        with self._lock:
            return {(dispatch.job_id, dispatch.attempt) for dispatch in self._taken - self._waiting.keys()}

    def strays(self) -> Set[str]:
        return frozenset()

    def drop(self, names: Collection[str]) -> None:
        pass

    def remove(self, job_id: str, attempt: int) -> None:
        dispatch = Dispatch(job_id, attempt)
        with self._lock:
            self._waiting.pop(dispatch, None)
            self._taken.discard(dispatch)

    def enqueue_upload(self, kind: KindName, upload_id: str) -> None:
        with self._lock:
            if (kind, upload_id) not in self._uploads:
                self._uploads.append((kind, upload_id))

    def contains_upload(self, kind: KindName, upload_id: str) -> bool:
        with self._lock:
            return (kind, upload_id) in self._uploads

    def take_upload(self) -> tuple[KindName, str] | None:
        """The next file for a worker, removed at once; None if none waits."""
        with self._lock:
            return self._uploads.pop(0) if self._uploads else None

    def enqueue_preview(self, request: PreviewRequest) -> None:
        with self._lock:
            if request not in self._previews:
                self._previews.append(request)

    def contains_preview(self, preview_id: str) -> bool:
        with self._lock:
            return any(request.id == preview_id for request in self._previews)

    def num_previews(self) -> int:
        with self._lock:
            return len(self._previews)

    def take_preview(self) -> PreviewRequest | None:
        """The next request for a worker, removed at once; None if none waits."""
        with self._lock:
            return self._previews.pop(0) if self._previews else None

    def waiting(self) -> Sequence[Dispatch]:
        """The attempts that no worker has taken, oldest first."""
        with self._lock:
            return list(self._waiting)

    def take(self, device: str = "cpu", hosts: int = 1) -> Dispatch | None:
        """The next attempt that a worker on this device of each host would get; None if none waits."""
        with self._lock:
            for name in queue_names(device, hosts):
                for dispatch, queue in self._waiting.items():
                    if queue == name:
                        del self._waiting[dispatch]
                        self._taken.add(dispatch)
                        return dispatch
        return None
