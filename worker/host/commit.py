"""The commit of the code that runs here."""

import subprocess
from contextlib import suppress
from pathlib import Path


def commit_here() -> str | None:
    """The commit, with `-dirty` after changes; None outside a clone.

    A process that is confined to its own files cannot ask git, so the supervisor does.
    """
    command = [
        "git",
        "-C",
        str(Path(__file__).parent),
        "describe",
        "--always",
        "--dirty",
        "--abbrev=40",
        "--exclude=*",
    ]
    with suppress(OSError, subprocess.SubprocessError):
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=5).stdout.strip()
    return None
