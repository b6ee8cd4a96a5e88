"""Folders and small files that belong to one user."""

import json
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from gaitway.service.embedded.processes import ServerFailed

_T = TypeVar("_T")


def private_folder(folder: Path) -> Path:
    """The absolute folder, made if needed, private to its owner. Raises ServerFailed without permission."""
    folder = folder.expanduser().resolve()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(0o700)
    except PermissionError as error:
        raise ServerFailed(_not_ours(folder, error)) from None
    return folder


def _not_ours(folder: Path, error: PermissionError) -> str:
    reason = "it, or a folder above it, belongs to another user"
    with suppress(OSError, KeyError):
        reason = f"it belongs to {folder.owner()}"
    return (
        f"{folder} cannot be used ({error.strerror}): {reason}. Name another folder by --data, or start as "
        "that user."
    )


def remembered(path: Path, make: Callable[[], _T]) -> _T:
    """The content of the JSON file; made at the first call, readable only by its owner."""
    if path.exists():
        return json.loads(path.read_text())
    value = make()
    write_private(path, json.dumps(value))
    return value


def write_private(path: Path, text: str) -> None:
    """Make or replace the file as a whole, readable only by its owner."""
    partial = path.with_suffix(".partial")
    with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
        file.write(text)
    partial.replace(path)
