"""Packages that a worker may lack: their modules, and their files without importing them."""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from core.errors import JobFailed
from core.reasons import Reason


def module(name: str, *, brings: str, install: str) -> Any:
    """A module of a package. brings: what comes with it, a sentence's beginning, such as "Corridors come with
    dm_control". install: the command for it. Raises JobFailed("bad_model") where it is not installed."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise _lacking(f"{brings}, which this worker does not have ({error})", install) from error


def file(package: str, path: str, *, brings: str, install: str) -> Path:
    """A file or folder of a package, which is not imported: some look for a display, or load much.

    Raises JobFailed("bad_model") where it is not there.
    """
    found = find_spec(package)
    for folder in (found.submodule_search_locations or []) if found is not None else []:
        if (there := Path(folder, path)).exists():
            return there
    raise _lacking(f"{brings}, which this worker does not have", install)


def _lacking(sentence: str, install: str) -> JobFailed:
    return JobFailed(
        Reason.BAD_MODEL, f"{sentence}. Install it there with `{install}`, or ask for another environment."
    )
