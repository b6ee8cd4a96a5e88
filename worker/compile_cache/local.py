"""A machine's compiled programs: files that never change, with the names that their makers gave them.

A job works in a folder of its own, with links to all of them. So it may write in place (JAX), or leave half a
file when it is killed: the machine's folder takes over whole files only, and only after a job got through its
compilation. A job that loads a user's model may have been taken over: it gets copies, which change nothing of
the machine's, and what it compiles is copied to a folder that only jobs with the same model get.
"""

import os
import re
import shutil
import sys
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import IO

from worker.host.disk import open_below

# In GAITWAY_DATA_DIR, for the machine; and in an attempt's spool, for the job.
CACHE = "cache"
# Warp's folders while it builds (they end in process and thread), its sources, which it never reads, and
# files that the engine `compiled` is still writing.
_NOT_KEPT = re.compile(r"_p\d+_t\d+/|\.(cu|cpp)$|^compiled/tmp")
# Bytes: the copies that a job with a user's model gets, the last used first; the programs that it may leave;
# one program unpacked.
_MOST_COPIED_BYTES = 2**28
_MOST_UNPACKED_BYTES = 2**29
_ZSTANDARD = b"\x28\xb5\x2f\xfd"


def names(folder: Path) -> set[str]:
    """Every file in it, relative to it."""
    return {path.relative_to(folder).as_posix() for path in _files(folder)}


def lend(kept: Path, own: Path) -> None:
    """Link everything that is kept into the job's folder, at no cost in space."""
    own.mkdir(parents=True, exist_ok=True)
    for name in names(kept):
        with suppress(FileNotFoundError):  # Another job's supervisor made room.
            _link(kept / name, own / name)


def take_over(own: Path, kept: Path) -> list[str]:
    """Keep what a job has compiled; returns the names of new, whole files."""
    new = [name for name in sorted(names(own) - names(kept)) if not _NOT_KEPT.search(name)]
    taken: list[str] = []
    for name in new:
        with suppress(FileNotFoundError, FileExistsError):
            if is_whole(own / name):
                write_out(own / name)
                _link(own / name, kept / name)
                taken.append(name)
    return taken


def lend_copies(folders: Sequence[Path], own: Path) -> set[str]:
    """Copy what the folders keep into the job's own, as far as there is room; returns its names."""
    found: dict[str, tuple[float, int, Path]] = {}
    for folder in folders:
        for name in names(folder):
            with suppress(FileNotFoundError):
                found.setdefault(name, _used(folder / name))
    left = _MOST_COPIED_BYTES
    lent: set[str] = set()
    for name, (_, size, path) in sorted(found.items(), key=lambda item: item[1], reverse=True):
        if size <= left:
            with suppress(FileNotFoundError), path.open("rb") as file:
                _copy(file, own / name)
                lent.add(name)
                left -= size
    return lent


def take_over_copies(own: Path, kept: Path, lent: set[str]) -> list[str]:
    """As `take_over`, of a job that may have been taken over: copies of plain files, up to a bound."""
    left = _MOST_COPIED_BYTES - sum(size for _, size, _ in map(_used, _files(kept)))
    taken: list[str] = []
    for name in sorted(names(own) - names(kept) - lent):
        beside = kept / f".{os.getpid()}-{Path(name).name[-6:]}"  # Its end says what kind of file it is.
        with suppress(OSError):
            if _NOT_KEPT.search(name):
                continue
            with open_below(own, name) as file:
                size = os.fstat(file.fileno()).st_size
                if size > left:
                    continue
                _copy(file, beside, size)
            if is_whole(beside):
                write_out(beside)
                (kept / name).parent.mkdir(parents=True, exist_ok=True)
                beside.replace(kept / name)
                taken.append(name)
                left -= size
        beside.unlink(missing_ok=True)
    return taken


def is_whole(path: Path) -> bool:
    """False if one of JAX's programs was cut short, as by a full disk; Warp moves whole files here."""
    if not path.name.endswith("-cache"):
        return True
    body = path.read_bytes()
    try:
        _decompress(body)
    except Exception:  # Each library has its own exceptions.
        return False
    return True


def write_out(path: Path) -> None:
    """fsync before the rename, so that a power cut cannot leave a truncated file."""
    with path.open("rb") as file:
        os.fsync(file.fileno())


def keep_within(folder: Path, max_bytes: int) -> None:
    """Remove the least recently used files until the rest has at most `max_bytes`.

    On most disks Linux records when a file is read. Where it does not (`noatime`), the oldest goes first.
    """
    found: list[tuple[float, int, Path]] = []
    for path in _files(folder):
        with suppress(FileNotFoundError):
            found.append(_used(path))
    excess = sum(size for _, size, _ in found) - max_bytes
    for _, size, path in sorted(found):
        if excess <= 0:
            return
        path.unlink(missing_ok=True)
        excess -= size
        with suppress(OSError):  # The folder goes with its last file.
            path.parent.rmdir()


def _decompress(body: bytes) -> None:
    """Raises an exception of some kind for a program that is not whole, or larger than one may be."""
    if not body.startswith(_ZSTANDARD):
        unpacker = zlib.decompressobj()
    elif sys.version_info >= (3, 14):
        unpacker = import_module("compression.zstd").ZstdDecompressor()
    else:  # JAX writes this format only if the package is installed.
        zstandard = import_module("zstandard")
        if zstandard.get_frame_parameters(body).content_size > _MOST_UNPACKED_BYTES:
            raise ValueError("The program is too large.")
        zstandard.decompress(body)
        return
    unpacker.decompress(body, _MOST_UNPACKED_BYTES)
    if not unpacker.eof:
        raise ValueError("The program is cut short, or too large.")


def _used(path: Path) -> tuple[float, int, Path]:
    """When it was last used, its size, and the path. Raises FileNotFoundError."""
    state = path.stat()
    return max(state.st_atime, state.st_mtime), state.st_size, path


def _files(folder: Path) -> Iterator[Path]:
    for parent, _, files in os.walk(folder):
        yield from (Path(parent, file) for file in files)


def _copy(file: IO[bytes], target: Path, most: int = _MOST_COPIED_BYTES) -> None:
    """At most so many bytes; blocks are shared until one side writes, where the disk can do that."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with target.open("wb", buffering=0) as copied:
        while most > 0 and (number := _copy_piece(file, copied, most)):
            most -= number


def _copy_piece(file: IO[bytes], copied: IO[bytes], most: int) -> int:
    try:
        return os.copy_file_range(file.fileno(), copied.fileno(), most)
    except (OSError, AttributeError):  # Not on every system, nor from every disk to every other.
        return copied.write(os.read(file.fileno(), min(most, 2**20)))


def _link(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        target.hardlink_to(source)
    except FileExistsError:
        raise
    except OSError:  # Not every file system has links.
        if not source.exists():
            raise FileNotFoundError(source) from None
        beside = target.with_name(f"{target.name}_p{os.getpid()}_t0")
        shutil.copy2(source, beside)
        beside.replace(target)
