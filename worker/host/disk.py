"""Checks for a full disk, and the advice to give then."""

import errno
import os
import platform
import shutil
import tempfile
from pathlib import Path

from core.errors import Misconfigured
from core.variables import variable

# Below this not even a small job's first files fit.
_LEAST_FREE_BYTES = 2**24


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
