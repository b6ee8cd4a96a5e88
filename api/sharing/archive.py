"""Reads a zip that somebody else has made: nothing is unpacked to disk, and little is in memory at a time."""

import hashlib
import io
import zlib
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, cast
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile, ZipInfo

from core.errors import BadExport

# The directory of a zip is read whole, and each entry of it takes 50 bytes or more there.
_LONGEST_DIRECTORY = 2**20
# A part of an upload to the object store has 8 MiB.
_LONGEST_READ = 2**24
LONGEST_DOCUMENT = 2**20
# A line of a log has 4,000 characters at most, and a row of metrics 500 numbers.
_LONGEST_LINE = 2**16
_PIECE = 2**20
_ENCRYPTED = 1


class _Bounded(io.FileIO):
    """A file of which nobody reads more than `most` bytes at once, whatever lengths a zip gives."""

    most = _LONGEST_DIRECTORY

    def read(self, size: int | None = -1, /) -> bytes:
        body = super().read(self.most + 1 if size is None or size < 0 else min(size, self.most + 1))
        if body is not None and len(body) > self.most:
            raise BadZipFile("its directory is too long")
        return body or b""


class Archive:
    """A zip whose names and sizes are harmless; `open_archive` makes it. names: those of its files."""

    def __init__(self, file: ZipFile) -> None:
        self._zip = file
        self.names = frozenset(info.filename for info in file.infolist() if not info.is_dir())

    def document(self, name: str) -> bytes:
        """The whole file; for small ones. Raises BadExport."""
        with self.open(name) as file, _reading():
            body = file.read(LONGEST_DOCUMENT + 1)
        if len(body) > LONGEST_DOCUMENT:
            raise BadExport(f"{name} is longer than {LONGEST_DOCUMENT:,} bytes.")
        return body

    def lines(self, name: str) -> Iterator[bytes]:
        """The file's lines without their ends. Raises BadExport."""
        with self.open(name) as file:
            # Whose own `readline` takes a hundred times as long.
            buffered = io.BufferedReader(cast("io.RawIOBase", file))
            while True:
                with _reading():
                    line = buffered.readline(_LONGEST_LINE + 1)
                if not line:
                    return
                if len(line) > _LONGEST_LINE:
                    raise BadExport(f"{name} has a line of more than {_LONGEST_LINE:,} bytes.")
                yield line.removesuffix(b"\n")

    def check(self, name: str, sha256: str, size: int) -> None:
        """Raises BadExport unless the file has this hash and size."""
        digest, found = hashlib.sha256(), 0
        with self.open(name) as file, _reading():
            while piece := file.read(_PIECE):
                digest.update(piece)
                found += len(piece)
        if found != size:
            raise BadExport(f"{name} has {found:,} bytes, and contents.json says {size:,}.")
        if digest.hexdigest() != sha256:
            raise BadExport(f"{name} does not have the SHA-256 that contents.json says: it is damaged.")

    @contextmanager
    def open(self, name: str) -> Generator[IO[bytes]]:
        """The file's bytes. Raises BadExport where it is not there."""
        if name not in self.names:
            raise BadExport(f"The zip has no {name}: it is not a whole export.")
        with _reading():
            file = self._zip.open(name)
        with file:
            yield file


@contextmanager
def open_archive(path: Path, limit: int) -> Generator[Archive]:
    """The zip at this path. limit: bytes that all its files may have, unpacked. Raises BadExport."""
    with _Bounded(path) as file:
        with _reading("This is not a zip file, or only a part of one"):
            archive = ZipFile(file)
        file.most = _LONGEST_READ
        with archive:
            _check(archive.infolist(), limit)
            yield Archive(archive)


def _check(entries: list[ZipInfo], limit: int) -> None:
    for entry in entries:
        name = entry.orig_filename
        if name.startswith("/") or "\\" in name or "\0" in name or ".." in name.split("/"):
            raise BadExport(f"The zip has a file {name[:200]!r}; an export has no such name.")
        if entry.flag_bits & _ENCRYPTED or entry.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
            raise BadExport(f"{name} is encrypted or compressed in another way than an export's files.")
    if len({entry.filename for entry in entries}) < len(entries):
        raise BadExport("The zip has two files of the same name.")
    # `zipfile` gives no more bytes of a file than the directory says.
    if (unpacked := sum(entry.file_size for entry in entries)) > limit:
        raise BadExport(
            f"The files in the zip have {unpacked:,} bytes, and this service accepts {limit:,}: its operator "
            "can raise GAITWAY_MAX_IMPORT_BYTES."
        )


@contextmanager
def _reading(sentence: str = "The zip is damaged") -> Generator[None]:
    """Turn what damaged bytes may raise into BadExport."""
    try:
        yield
    except BadExport:
        raise
    # A zip of another kind is a NotImplementedError or a RuntimeError, a wrong place in the file an OSError.
    except (BadZipFile, EOFError, zlib.error, ValueError, OSError, RuntimeError) as error:
        raise BadExport(f"{sentence} ({error}).") from error
