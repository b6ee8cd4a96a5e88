"""A machine's compiled programs: files that never change, with the names that their makers gave them.

A job works in a folder of its own, with links to all of them. So it may write in place (JAX), or leave half a
file when it is killed: the machine's folder takes over whole files only, and only after a job got through its
compilation.
"""

import os
import re
import shutil
import sys
import zlib
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path

# In GAITWAY_DATA_DIR, for the machine; and in an attempt's spool, for the job.
CACHE = "cache"
# Warp's folders while it builds (they end in process and thread), its sources, which it never reads, and
# files that the engine `compiled` is still writing.
_NOT_KEPT = re.compile(r"_p\d+_t\d+/|\.(cu|cpp)$|^compiled/tmp")
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
            state = path.stat()
            found.append((max(state.st_atime, state.st_mtime), state.st_size, path))
    excess = sum(size for _, size, _ in found) - max_bytes
    for _, size, path in sorted(found):
        if excess <= 0:
            return
        path.unlink(missing_ok=True)
        excess -= size
        with suppress(OSError):  # The folder goes with its last file.
            path.parent.rmdir()


def _decompress(body: bytes) -> None:
    if not body.startswith(_ZSTANDARD):
        zlib.decompress(body)
    elif sys.version_info >= (3, 14):
        import_module("compression.zstd").decompress(body)
    else:  # JAX writes this format only if the package is installed.
        import_module("zstandard").decompress(body)


def _files(folder: Path) -> Iterator[Path]:
    for parent, _, files in os.walk(folder):
        yield from (Path(parent, file) for file in files)


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
