"""Reading an object whose hash the record names."""

import hashlib
import os
from collections.abc import Collection
from pathlib import Path

from core.errors import ObjectDamaged, StorageUnavailable
from core.storage.objects import ObjectStore

# A byte may be flipped on the way, too: only what is wrong at each reading is wrong in the store.
READINGS = 3
OTHER_BYTES = "its bytes do not have the SHA-256 that the record names"


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
