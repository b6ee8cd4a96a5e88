"""Checks for a full disk, and opens the files that a process which may have been taken over has left there.

Such a process may put a link or a pipe where a file is expected, and change that while somebody looks.
"""

import errno
import os
import platform
import shutil
import stat
import tempfile
from io import BufferedReader
from pathlib import Path

from core.errors import Misconfigured
from core.variables import variable

# Below this not even a small job's first files fit.
_LEAST_FREE_BYTES = 2**24
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_FILE = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


def is_full(error: BaseException) -> bool:
    """Whether it says that a disk, or this user's share of it, has no room left."""
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)


def what_to_do(folder: Path | None = None) -> str:
    """The advice, as a sentence. folder: the value of GAITWAY_DATA_DIR; None: as in the environment."""
    name = variable("data_dir")
    return (
        f"The disk of the worker on {platform.node()} is full: free space at "
        f"{name}={folder or os.environ.get(name)}, or let it name a folder on a larger disk."
    )


def has_room(folder: Path) -> bool:
    """Whether a job may start here."""
    return shutil.disk_usage(folder).free >= _LEAST_FREE_BYTES


def check_folder(folder: Path) -> None:
    """Make the folder, private to this user. Raises Misconfigured if nothing can be written to it."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        if is_full(error):  # This may pass: until then no job starts.
            return
        raise Misconfigured(
            f"{variable('data_dir')}={folder}, and user {os.getuid()} cannot write there "
            f"({error.strerror}): give that user the folder or the volume, or name another one."
        ) from error


class NotPlain(OSError):
    """It is no plain file of that folder."""


def open_plain(folder: Path, name: str) -> BufferedReader:
    """A regular file in the folder, for reading: it follows no link, and waits for no pipe.

    Ask the open file for its size: another file may have its name by now.
    Raises NotPlain, and FileNotFoundError.
    """
    if Path(name).name != name:
        raise NotPlain(f"{name!r} is not the plain name of a file.")
    return open_below(folder, name)


def open_below(folder: Path, path: str) -> BufferedReader:
    """As `open_plain`, of a file anywhere below the folder. Raises NotPlain, and FileNotFoundError."""
    parts = Path(path).parts
    if not parts or Path(path).is_absolute() or ".." in parts:
        raise NotPlain(f"{path!r} leads elsewhere.")
    opened = [os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)]
    try:
        for part in parts[:-1]:
            opened.append(os.open(part, _FOLDER, dir_fd=opened[-1]))
        file = os.fdopen(os.open(parts[-1], _FILE, dir_fd=opened[-1]), "rb")
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:  # A link, a socket, a folder where a file should be, a zero byte.
        raise NotPlain(f"{path!r} is no plain file: {error}.") from error
    finally:
        for descriptor in opened:
            os.close(descriptor)
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise NotPlain(f"{path!r} is no plain file.")
    return file


def read_plain(path: Path, most_bytes: int) -> bytes:
    """The end of a file that such a process has left. Raises OSError."""
    with open_plain(path.parent, path.name) as file:
        size = os.fstat(file.fileno()).st_size
        file.seek(max(0, size - most_bytes))
        return file.read(most_bytes)
