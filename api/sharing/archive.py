"""Reads a zip that somebody else has made: nothing is unpacked to disk, and little is in memory at a time.

Another version may have written its documents, or anybody else: every field that is kept has a bound, and
unknown ones are ignored.
"""

import hashlib
import io
import zlib
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from sys import float_info
from typing import IO, Annotated
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile, ZipInfo

from pydantic import AwareDatetime, Field, StringConstraints

from api.sharing.export import FORMAT
from core.bounds import (
    LONGEST_MESSAGE,
    LONGEST_NAME,
    MOST_ATTEMPTS,
    MOST_FILES,
    MOST_IN_A_ROW,
    Facts,
    JobDocument,
    PastStep,
)
from core.documents import Stored
from core.errors import BadExport
from core.jobs.job import ArtifactRole
from core.jobs.spec import JobId
from core.jobs.status import JobStatus
from core.reasons import Reason

# Times that PostgreSQL stores and Python reads.
FIRST_MOMENT, LAST_MOMENT = datetime(1970, 1, 1, tzinfo=UTC), datetime(3000, 1, 1, tzinfo=UTC)
Moment = Annotated[AwareDatetime, Field(ge=FIRST_MOMENT, lt=LAST_MOMENT)]
Name = Annotated[str, StringConstraints(max_length=LONGEST_NAME)]
Message = Annotated[str, StringConstraints(max_length=LONGEST_MESSAGE)]
Size = Annotated[int, Field(ge=0, le=2**60)]
# Any number but those that are not finite.
Number = Annotated[float, Field(ge=-float_info.max, le=float_info.max)]
Metrics = Annotated[dict[Name, Number | None], Field(max_length=MOST_IN_A_ROW)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
# The directory of a zip is read whole, and each entry of it takes 50 bytes or more there.
_LONGEST_DIRECTORY = 2**20
# A part of an upload to the object store has 8 MiB.
_LONGEST_READ = 2**24
LONGEST_DOCUMENT = 2**20
# A line of a log has 4,000 characters at most, and a row of metrics 500 numbers.
_LONGEST_LINE = 2**16
_PIECE = 2**20
_ENCRYPTED = 1


class ArchiveFormat(Stored):
    format: Annotated[int, Field(ge=0, le=10**9)] = FORMAT


class ExportedFile(Stored):
    path: Annotated[str, Field(max_length=2 * LONGEST_NAME)]
    sha256: Sha256
    size: Size


class Contents(Stored):
    files: Annotated[tuple[ExportedFile, ...], Field(max_length=MOST_FILES)]


class ArchivePackage(Stored):
    gaitway: Annotated[str, Field(max_length=100)]


class Versions(Stored):
    service: ArchivePackage


class ExportedArtifact(Stored):
    name: Annotated[str, Field(pattern=r"^[^/\\]+$", max_length=200)]
    role: ArtifactRole
    # It becomes a header of answers.
    media_type: Annotated[str, Field(pattern=r"^[A-Za-z0-9.+-]+/[A-Za-z0-9.+-]+$", max_length=100)]
    size: Size
    sha256: Sha256
    step: PastStep | None = None
    metadata: Facts = {}


class ExportedAttempt(Stored):
    number: Annotated[int, Field(ge=1, le=MOST_ATTEMPTS)]
    worker: Name
    device: Name | None = None
    engine: Name | None = None
    peak_bytes: Size | None = None
    gpu_part: Annotated[float, Field(ge=0, le=1)] | None = None
    details: Facts = {}
    started_at: Moment
    ended_at: Moment | None = None
    reason: Reason | None = None
    message: Message | None = None


class ExportedProgress(Stored):
    step: PastStep = 0
    total: PastStep = 0
    steps_per_second: Number | None = None
    eta_s: Number | None = None
    # Null where one was not finite.
    metrics: Metrics = {}


class Record(Stored):
    """`job.json`: a JobView."""

    id: JobId
    spec: JobDocument
    status: JobStatus
    reason: Reason | None = None
    message: Message | None = None
    created_at: Moment
    started_at: Moment | None = None
    finished_at: Moment | None = None
    progress: ExportedProgress = ExportedProgress()
    attempts: Annotated[tuple[ExportedAttempt, ...], Field(max_length=MOST_ATTEMPTS)] = ()
    artifacts: Annotated[tuple[ExportedArtifact, ...], Field(max_length=MOST_FILES)] = ()


class ArchiveRow(Stored):
    """A line of `metrics.jsonl`."""

    step: PastStep
    time: Moment
    values: Metrics


class _Bounded(io.FileIO):
    """A file of which nobody reads more than `most` bytes at once, whatever lengths a zip gives."""

    most = _LONGEST_DIRECTORY

    def read(self, size: int | None = -1, /) -> bytes:
        body = super().read(self.most + 1 if size is None or size < 0 else min(size, self.most + 1))
        if body is not None and len(body) > self.most:
            raise BadZipFile("its directory is too long")
        return body or b""


class JobArchive:
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
            rest, is_end = b"", False
            while not is_end:
                with _reading():
                    piece = file.read(_PIECE)
                *lines, rest = (rest + piece).split(b"\n")
                if is_end := not piece:
                    lines = [rest] * bool(rest)
                if max(map(len, [*lines, rest])) > _LONGEST_LINE:
                    raise BadExport(f"{name} has a line of more than {_LONGEST_LINE:,} bytes.")
                yield from lines

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
def open_archive(path: Path, limit: int) -> Generator[JobArchive]:
    """The zip at this path. limit: bytes that all its files may have, unpacked. Raises BadExport."""
    with _Bounded(path) as file:
        with _reading("This is not a zip file, or only a part of one"):
            archive = ZipFile(file)
        file.most = _LONGEST_READ
        with archive:
            _check(archive.infolist(), limit)
            yield JobArchive(archive)


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
