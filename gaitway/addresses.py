"""Addresses and names for both clients: the service's address, paths on it, ids and files."""

import json
import os
import shutil
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote
from zipfile import BadZipFile, ZipFile, ZipInfo

import httpx

from gaitway.errors import WrongAddress
from gaitway.local import running

DEFAULT_URL = "http://127.0.0.1:8000"
ID_LENGTH = 23
# Between two looks at what a worker has yet to do.
POLL_S = 0.5
# An abbreviated id is looked for among this many jobs.
SEARCHED = 1000
# Far beyond what a service takes, in bytes: a larger file in an export is not unpacked.
_LARGEST = 2**30

# Called with the bytes that are here, and those of the whole file.
OnBytes = Callable[[int, int], None]


def address(base_url: str | None) -> str:
    """The service's address: the given one, that of GAITWAY_URL, or this machine's. Raises WrongAddress.

    This machine's is that of the newest `gaitway up`, otherwise the port at which services are by default.
    """
    url = base_url or os.environ.get("GAITWAY_URL") or running() or DEFAULT_URL
    if not url.lower().startswith(("http://", "https://")):
        raise WrongAddress(url)
    return url.rstrip("/")


def http_options(base_url: str) -> dict[str, Any]:
    """The options of an httpx client. No proxy of the environment reaches services on this machine."""
    is_here = httpx.URL(base_url).host in ("127.0.0.1", "localhost", "::1")
    return {"base_url": base_url, "follow_redirects": True, "trust_env": not is_here}


def path_of(*parts: str) -> str:
    # Quoted, so that an id or a name with a slash or dots cannot become another address.
    return "".join(f"/{quote(part, safe='')}" for part in parts)


def the_one(name: str, ids: Sequence[str], kind: str) -> str:
    """The id, of these newest first, that `last`, a beginning or an end means.

    kind: a word for what they name. Raises LookupError, where none or several fit.
    """
    if name == "last":
        if ids:
            return ids[0]
        raise LookupError(f"There is no {kind} yet.")
    fitting = [full_id for full_id in ids if full_id.startswith(name) or full_id.endswith(name)]
    if len(fitting) == 1:
        return fitting[0]
    if not fitting:
        raise LookupError(
            f"None of the newest {SEARCHED:,} {kind}s has an id that begins or ends with {name!r}."
        )
    raise LookupError(f"{name!r} fits {len(fitting)} {kind}s: {', '.join(fitting[:5])}. Give more of the id.")


def target(name: str, path: str | Path | None) -> Path:
    """Where the file goes: `path`, or inside it when it is a folder; by default here."""
    chosen = Path(path) if path is not None else Path.cwd()
    return chosen / PurePosixPath(name).name if chosen.is_dir() else chosen


def models_in(archive: Path, folder: Path) -> list[Path]:
    """The models in an export, unpacked into the folder; none of a damaged zip, which the service refuses."""
    try:
        with ZipFile(archive) as opened:
            return _unpacked(opened, "model", folder)
    except _DAMAGED:
        return []


def clips_in(archive: Path, folder: Path) -> list[tuple[Path, dict[str, Any]]]:
    """The files of clips in an export, unpacked into the folder, each with its name, body and rate; none of a
    damaged zip."""
    try:
        with ZipFile(archive) as opened:
            if "clips.json" not in opened.namelist():
                return []
            told = {one["path"]: one for one in json.loads(opened.read("clips.json"))["files"]}
            names = [info.filename for info in _members(opened, "clips")]
            found = zip(names, _unpacked(opened, "clips", folder), strict=True)
            return [(file, told[name]) for name, file in found if name in told]
    except (*_DAMAGED, ValueError, KeyError, TypeError):
        return []


# RuntimeError: an unknown compression, or a password.
_DAMAGED = (BadZipFile, zlib.error, RuntimeError)


def _unpacked(opened: ZipFile, what: str, folder: Path) -> list[Path]:
    """The members in the folder of this name, as files in another folder."""
    members = _members(opened, what)
    files = [folder / f"{what}-{number}" for number in range(len(members))]
    for member, file in zip(members, files, strict=True):
        with opened.open(member) as source, file.open("wb") as target:
            shutil.copyfileobj(source, target)
    return files


def _members(opened: ZipFile, what: str) -> list[ZipInfo]:
    return [
        info
        for info in opened.infolist()
        if info.filename.startswith(f"{what}/") and not info.is_dir() and info.file_size <= _LARGEST
    ]
