"""A zip file made while it is sent: no member is ever whole in memory, and nothing is written to disk."""

import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

# An older date cannot be said in a zip. A fixed one makes equal exports equal.
_WHEN = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class Member:
    """A file of the zip. pieces: read as it is sent. compress: whether that makes it smaller."""

    path: str
    pieces: Iterable[bytes]
    compress: bool = True


class _Pipe(io.RawIOBase):
    """Takes what the zip writes. It cannot go back, so that a member's size follows its bytes."""

    def __init__(self) -> None:
        self._written = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, piece: object) -> int:
        before = len(self._written)
        self._written += memoryview(piece)  # pyright: ignore[reportArgumentType] # whatever has bytes
        return len(self._written) - before

    def taken(self) -> bytes:
        taken = bytes(self._written)
        self._written.clear()
        return taken


def zip_stream(members: Iterable[Member]) -> Iterator[bytes]:
    """The bytes of a zip (64-bit where needed) of these members, in about the pieces that they come in.

    An error of a member's pieces ends it, so that what arrived has no directory and no program opens it.
    """
    pipe = _Pipe()
    with ZipFile(pipe, "w", allowZip64=True) as archive:
        for member in members:
            info = ZipInfo(member.path, _WHEN)
            info.compress_type = ZIP_DEFLATED if member.compress else ZIP_STORED
            info.external_attr = 0o644 << 16
            with archive.open(info, "w", force_zip64=True) as file:
                for piece in member.pieces:
                    file.write(piece)
                    if written := pipe.taken():
                        yield written
            yield pipe.taken()
    yield pipe.taken()
