"""The keys that every supported object store keeps unchanged."""

from core.errors import ObjectNotFound, Rejected

LONGEST_KEY_BYTES = 1024
LONGEST_PART_BYTES = 255
PIECE_BYTES = 2**20


def is_portable(key: str) -> bool:
    """Whether S3 servers that keep objects in folders store this key unchanged.

    They differ in empty parts, `.` and `..`, long parts, and control characters.
    """
    if not key.isprintable() or len(key.encode()) > LONGEST_KEY_BYTES:
        return False
    parts = key.split("/")
    return all(part not in ("", ".", "..") and len(part.encode()) <= LONGEST_PART_BYTES for part in parts)


def check_writable(key: str) -> str:
    """The same key; raises Rejected if some store would not keep it."""
    if not is_portable(key):
        raise Rejected(f"{key[:100]!r} cannot be the name of an object.")
    return key


def check_readable(key: str) -> str:
    """The same key; raises ObjectNotFound if no object can have it."""
    if not is_portable(key):
        raise ObjectNotFound(key[:100])
    return key
