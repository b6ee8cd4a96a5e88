"""The interface of the object store, and reading an object whose hash the record names."""

import hashlib
import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import IO, Protocol

from core.errors import ObjectDamaged, StorageUnavailable

# A byte may be flipped on the way, too: only what is wrong at each reading is wrong in the store.
READINGS = 3
OTHER_BYTES = "its bytes do not have the SHA-256 that the record names"


@dataclass(frozen=True)
class ObjectInfo:
    """The facts that the store knows about an object without reading it. size: bytes.

    modified_at: when it was put, by the store's clock; None if the store does not say.
    """

    key: str
    size: int
    media_type: str = "application/octet-stream"
    metadata: Mapping[str, str] = field(default_factory=dict[str, str])
    modified_at: datetime | None = field(default=None, compare=False)


class ObjectStore(Protocol):
    """Named byte strings; a put replaces the whole object or nothing.

    Every method raises StorageUnavailable when the store cannot be reached or refuses its key. An object that
    cannot be read while others can is no outage: `get` and `open` raise ObjectDamaged, an ObjectNotFound,
    within about ten seconds; `open` also while its pieces are read.
    """

    def put(self, key: str, body: bytes, *, media_type: str = "application/octet-stream") -> None: ...

    def put_file(self, key: str, path: Path, *, media_type: str = "application/octet-stream") -> None:
        """Store a file without holding it in memory."""
        ...

    def put_stream(
        self, key: str, stream: IO[bytes], size: int, *, media_type: str = "application/octet-stream"
    ) -> None:
        """Store the next `size` bytes of the stream, of which a few MiB are in memory at a time.

        Nothing is stored if reading them raises an error, which is passed on.
        """
        ...

    def get(self, key: str) -> bytes:
        """The whole object; for small ones. Raises ObjectNotFound."""
        ...

    def open(
        self, key: str, start: int = 0, length: int | None = None, *, size: int | None = None
    ) -> AbstractContextManager[Iterator[bytes]]:
        """Bytes [start, start + length) in pieces of at most 1 MiB. size: that the whole object must have,
        else it is damaged. Raises ObjectNotFound at once."""
        ...

    def info(self, key: str) -> ObjectInfo:
        """Raises ObjectNotFound."""
        ...

    def list(self, prefix: str) -> Iterator[ObjectInfo]:
        """Every object whose key begins with `prefix`, in key order.

        A listing of any length takes little memory; its later pages may be fetched while it is read.
        """
        ...

    def delete(self, keys: Iterable[str]) -> None:
        """Remove these objects; a missing one is no error."""
        ...

    def delete_prefix(self, prefix: str) -> None:
        """Remove every object under `prefix`; it is no error if there is none."""
        ...

    def end_uploads(self, prefix: str, before: datetime) -> int:
        """End unfinished uploads of large objects that began before then, and remove what came of them.

        prefix: of the objects' keys. Returns how many; a call may leave some to the next one.
        """
        ...


def read_whole(key: str, sha256: str, objects: ObjectStore) -> bytes:
    """The bytes, which have this hash. For small objects.

    Raises ObjectNotFound; ObjectDamaged; StorageUnavailable, also where each reading gives other bytes.
    """
    digests = set[str]()
    for _ in range(READINGS):
        body = objects.get(key)
        digests.add(digest := hashlib.sha256(body).hexdigest())
        if digest == sha256:
            return body
    raise _wrong(key, digests)


def save_whole(key: str, sha256: str, objects: ObjectStore, path: Path, size: int | None = None) -> None:
    """Write an object, which may be large, to the file. size: bytes, where the record names them.

    Raises ObjectNotFound; ObjectDamaged; StorageUnavailable, also where each reading gives other bytes.
    """
    digests = set[str]()
    for _ in range(READINGS):
        digest = hashlib.sha256()
        with objects.open(key, size=size) as pieces, path.open("wb") as file:
            for piece in pieces:
                digest.update(piece)
                file.write(piece)
        if digest.hexdigest() == sha256:
            return
        digests.add(digest.hexdigest())
    raise _wrong(key, digests)


def check_whole(key: str, sha256: str, objects: ObjectStore) -> None:
    """Read the object, which may be large, for its hash alone. Raises as `save_whole`."""
    save_whole(key, sha256, objects, Path(os.devnull))


def _wrong(key: str, digests: Collection[str]) -> ObjectDamaged | StorageUnavailable:
    if len(digests) == 1:
        return ObjectDamaged(key, OTHER_BYTES)
    # They are damaged in transit.
    return StorageUnavailable(f"The bytes of {key} do not have the SHA-256 that the record names.")
