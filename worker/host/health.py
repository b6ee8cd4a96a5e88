"""A sign of life for a container's health check: a file whose age shows when its process last worked.

`python -m worker.host.health` is the health check: exit status 0 while the last sign, or that of every
member of a fleet, is younger than a minute.
"""

import glob
import os
import sys
import time
from pathlib import Path

from core.variables import variable

_LONGEST_SILENCE_S = 60.0


def show_life(file: Path | None) -> None:
    """Touch the file, if one is set."""
    if file is not None:
        file.touch()


def silence_s(file: Path) -> float:
    """The seconds since the last sign; infinite if there was none."""
    try:
        return time.time() - file.stat().st_mtime
    except FileNotFoundError:
        return float("inf")


def begin_fleet(file: Path, num_members: int) -> list[Path]:
    """A file for each member, beside this one. Each starts fresh: its worker has a minute to start."""
    for old in _of_members(file):
        old.unlink()
    signs = [file.with_name(f"{file.name}.{number}") for number in range(num_members)]
    for sign in signs:
        sign.touch()
    return signs


def longest_silence_s(file: Path) -> float:
    """The silence of the process that touches this file, or the longest of the members of its fleet."""
    return max(map(silence_s, _of_members(file) or [file]))


def _of_members(file: Path) -> list[Path]:
    return list(file.parent.glob(f"{glob.escape(file.name)}.*"))


if __name__ == "__main__":
    sys.exit(longest_silence_s(Path(os.environ[variable("alive_file")])) > _LONGEST_SILENCE_S)
