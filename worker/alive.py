"""A sign of life for whoever watches a container: a file whose age tells when its process last worked.

`python -m worker.alive` is the health check: exit status 0 while the last sign is younger than a minute.
"""

import os
import sys
import time
from pathlib import Path

from core.configuration import variable

_LONGEST_SILENCE_S = 60.0


def show_life(file: Path | None) -> None:
    """Touch the file, if one is set."""
    if file is not None:
        file.touch()


def silence_s(file: Path) -> float:
    """How long ago the last sign was; infinite if there was none."""
    try:
        return time.time() - file.stat().st_mtime
    except FileNotFoundError:
        return float("inf")


if __name__ == "__main__":
    sys.exit(silence_s(Path(os.environ[variable("alive_file")])) > _LONGEST_SILENCE_S)
