"""The user's data folder, and in it the addresses of the services that `gaitway up` runs on this machine.

Each has a file, which it locks as long as it runs: a file that nobody locks belongs to a service that was
killed.
"""

import os
import socket
import sys
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path


def user_data_folder() -> Path:
    """Where this user's programs keep their data, as platformdirs' `user_data_path("gaitway")`."""
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Application Support" / "gaitway"
    named = os.environ.get("XDG_DATA_HOME", "").strip()
    return (Path(named) if named else Path.home() / ".local" / "share") / "gaitway"


def running() -> str | None:
    """The address of the service that this user has started last here by `gaitway up`, if one runs."""
    with suppress(OSError, RuntimeError):  # There is no such folder, or this user has no home.
        newest_first = sorted(_folder().iterdir(), key=lambda file: file.stat().st_mtime, reverse=True)
        return next((file.read_text() for file in newest_first if _is_locked(file)), None)
    return None


@contextmanager
def announced(url: str) -> Generator[None]:
    """Within this, `running` answers the address. Raises OSError, or RuntimeError without a home."""
    import fcntl

    _folder().mkdir(parents=True, exist_ok=True)
    path = _folder() / url.rpartition(":")[2]
    with path.open("w") as file:
        file.write(url)
        file.flush()
        fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def _folder() -> Path:
    # By machine: the home of several machines may be one.
    return user_data_folder() / "running" / socket.gethostname()


def _is_locked(path: Path) -> bool:
    try:
        import fcntl
    except ImportError:  # Windows, where no service runs.
        return False
    with path.open() as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
