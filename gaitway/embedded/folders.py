"""Folders and small files that belong to one user."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

_T = TypeVar("_T")


def private_folder(folder: Path) -> Path:
    """The absolute folder, made if need be, for its owner alone."""
    folder = folder.expanduser().resolve()
    folder.mkdir(parents=True, exist_ok=True)
    folder.chmod(0o700)
    return folder


def remembered(path: Path, make: Callable[[], _T]) -> _T:
    """What the file holds (JSON); it is made at the first call, readable by its owner alone."""
    if path.exists():
        return json.loads(path.read_text())
    value = make()
    write_private(path, json.dumps(value))
    return value


def write_private(path: Path, text: str) -> None:
    """Make or replace the file as a whole, readable by its owner alone."""
    partial = path.with_suffix(".partial")
    with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
        file.write(text)
    partial.replace(path)
