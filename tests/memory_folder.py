"""Where the tests' servers keep their files: in memory, where there is room for them.

Each of a thousand tests has a database of its own, of three hundred files. To make and remove those takes
20 ms of processor time in memory, and up to 300 ms on a disk: ext4 without a journal uses no inode again
within a minute, and for each new file looks at all that were freed since.
"""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

_MEMORY = Path("/dev/shm")
_PREFIX = "gaitway-tests-"
# A container's 64 MiB are not enough for the log of PostgreSQL alone.
_ENOUGH_BYTES = 2 * 2**30


@contextmanager
def memory_folder(otherwise: Path) -> Iterator[Path]:
    """A new folder in memory, which is removed again; `otherwise` where there is too little."""
    if not _MEMORY.is_dir() or shutil.disk_usage(_MEMORY).free < _ENOUGH_BYTES:
        yield otherwise
        return
    _remove_left_over()
    with tempfile.TemporaryDirectory(prefix=f"{_PREFIX}{os.getpid()}-", dir=_MEMORY) as folder:
        yield Path(folder)


def _remove_left_over() -> None:
    """Folders of test runs that were killed: nobody else would give their memory back."""
    for folder in _MEMORY.glob(f"{_PREFIX}*"):
        pid = int(folder.name.removeprefix(_PREFIX).partition("-")[0])
        if not psutil.pid_exists(pid):
            shutil.rmtree(folder, ignore_errors=True)
