"""The commit of the code that runs here."""

import subprocess
from contextlib import suppress
from pathlib import Path

_CODE = Path(__file__).resolve().parents[2]


def commit_here() -> str | None:
    """The commit, with `-dirty` after changes; None outside a clone.

    A process that is confined to its own files cannot ask git, so the supervisor does.
    """
    if not (
        _CODE / ".git"
    ).exists():  # An environment within a clone of something else has that one's commit.
        return None
    command = [
        *("git", "-C", str(_CODE)),
        *("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"),
    ]
    with suppress(OSError, subprocess.SubprocessError):
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=5).stdout.strip()
    return None
