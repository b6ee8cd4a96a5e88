"""SeaweedFS's volumes as they lie on the disk: one byte of a stored object becomes another one."""

import gzip
import struct
from collections.abc import Iterator
from pathlib import Path

# An entry of an index is a key, an offset in units of 8 bytes (its last byte is the highest), and a size; a
# needle is a cookie, its key and its size, then the data behind its length.
_ENTRY = struct.Struct(">QIBI")
_DATA_AT = 16 + 4


def flip_byte(folder: Path, body: bytes) -> int:
    """Damage each stored copy of this body, of which a volume may hold the first MiBs; returns how many.

    folder: of the store's data. The store serves everything else as before.
    """
    num_flipped = 0
    for index in folder.rglob("*.idx"):
        volume = index.with_suffix(".dat")
        with volume.open("r+b") as file:
            for at, size in _needles(index):
                file.seek(at + 16)
                length = int.from_bytes(file.read(4), "big")
                data = file.read(length) if 0 < length <= size else b""
                if data and body.startswith(_plain(data)):
                    middle = at + _DATA_AT + length // 2
                    file.seek(middle)
                    file.write(bytes([data[length // 2] ^ 1]))
                    num_flipped += 1
    return num_flipped


def _needles(index: Path) -> Iterator[tuple[int, int]]:
    """Where each needle that is still there begins, and its size."""
    entries = index.read_bytes()
    whole = len(entries) - len(entries) % _ENTRY.size
    read = _ENTRY.iter_unpack(entries[:whole])
    newest = {key: (8 * (low + (high << 32)), size) for key, low, high, size in read}
    for at, size in newest.values():
        if at and 0 < size < 2**31:
            yield at, size


def _plain(data: bytes) -> bytes:
    if not data.startswith(b"\x1f\x8b"):
        return data
    try:
        return gzip.decompress(data)
    except (OSError, EOFError):
        return data
