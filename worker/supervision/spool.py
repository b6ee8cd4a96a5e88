"""An attempt's own folder. It is removed with the attempt or, if that was killed, by the next one here."""

import shutil
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from core.retry import pause
from worker.host import file_lock

# The folder of all attempts' spools, in GAITWAY_DATA_DIR.
SPOOLS = "spool"
_PAUSE_S = 0.01
_LOCK, _PRIVATE = ".lock", ".private"


def private(path: Path) -> Path:
    """The folder beside a spool for what its training process, which may be taken over, must not reach."""
    return path.with_name(path.name + _PRIVATE)


@contextmanager
def spool(path: Path) -> Generator[Path]:
    """The folder, empty at first, and locked for as long as this process lives: workers may share a disk."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = path.with_name(path.name + _LOCK)
    while (descriptor := file_lock.take(lock)) is None:
        pause(_PAUSE_S)  # Another worker is checking whether somebody holds it.
    try:
        path.mkdir(exist_ok=True)
        private(path).mkdir(exist_ok=True)
        yield path
    finally:
        _remove(path, lock, descriptor)


def remove_left_over(folder: Path) -> None:
    """Remove the spools in this folder that no process holds: their containers were killed."""
    names = {file.name.removesuffix(_LOCK).removesuffix(_PRIVATE) for file in folder.glob("*")}
    for name in names:
        lock = folder / (name + _LOCK)
        with suppress(OSError):  # The next worker tries again.
            if (descriptor := file_lock.take(lock)) is not None:
                _remove(folder / name, lock, descriptor)


def _remove(path: Path, lock: Path, descriptor: int) -> None:
    for one in (path, private(path)):
        shutil.rmtree(one, ignore_errors=True)
    file_lock.remove(lock, descriptor)  # Last: until then nobody else touches the folder.
