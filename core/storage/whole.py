"""Reading an object whose hash the record names."""

import hashlib
from collections.abc import Collection

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


def check_whole(key: str, sha256: str, objects: ObjectStore) -> None:
    """Read the object, which may be large, for its hash alone.

    Raises ObjectNotFound; ObjectDamaged; StorageUnavailable, also where each reading gives other bytes.
    """
    digests = set[str]()
    for _ in range(READINGS):
        digest = hashlib.sha256()
        with objects.open(key) as pieces:
            for piece in pieces:
                digest.update(piece)
        if digest.hexdigest() == sha256:
            return
        digests.add(digest.hexdigest())
    raise _wrong(key, digests)


def _wrong(key: str, digests: Collection[str]) -> ObjectDamaged | StorageUnavailable:
    if len(digests) == 1:
        return ObjectDamaged(key, OTHER_BYTES)
    # They are damaged in transit.
    return StorageUnavailable(f"The bytes of {key} do not have the SHA-256 that the record names.")
