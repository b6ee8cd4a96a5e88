"""Brings the page's libraries from npm, as `api/pages/vendor/lock.json` names them: `./run vendor`.

The files are committed, so that neither users nor images need the registry. The lock has, for each package,
its version, licence and the sha512 of its archive (as npm states it); for each file, where it goes, the words
that are replaced in it, and the sha512 of the result. A path that ends in `.gz` holds its file compressed;
the sha512 is that of the file itself, since not every zlib makes the same bytes.
"""

import base64
import gzip
import hashlib
import json
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

from pydantic import BaseModel, ConfigDict

ROOT = Path(__file__).parents[2]
LOCK = ROOT / "api" / "pages" / "vendor" / "lock.json"


class VendoredFile(BaseModel):
    """A file of a package. path: from the repository's root; replace: words, and what stands for them.

    source: empty for a file that the package lacks, such as its licence: it is kept here, and only checked.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    source: str = ""
    path: str
    replace: dict[str, str] = {}
    append: str = ""
    sha512: str = ""


class NpmPackage(BaseModel):
    """A package of the registry. integrity: of its archive, as npm's own lock files have it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    version: str
    licence: str
    integrity: str = ""
    files: list[VendoredFile]


class Lock(BaseModel):
    """All vendored packages."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    packages: list[NpmPackage]


class NotAsLocked(Exception):
    """The sentence names the package or file that differs from the lock."""


def read_lock() -> Lock:
    return Lock.model_validate_json(LOCK.read_bytes())


def sha512(content: bytes) -> str:
    """The digest as npm writes it."""
    return "sha512-" + base64.b64encode(hashlib.sha512(content).digest()).decode()


def bring(package: NpmPackage) -> NpmPackage:
    """Write the package's files; returns it with the digests that the lock lacks. Raises NotAsLocked."""
    with tempfile.TemporaryDirectory() as folder:
        archive = _fetch(package, Path(folder))
        integrity = _checked(package.name, archive.read_bytes(), package.integrity)
        with tarfile.open(archive) as opened:
            files = [_write(file, opened) for file in package.files]
    return package.model_copy(update={"integrity": integrity, "files": files})


def _fetch(package: NpmPackage, folder: Path) -> Path:
    command = [
        "npm",
        "pack",
        "--silent",
        "--pack-destination",
        str(folder),
        f"{package.name}@{package.version}",
    ]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    [archive] = folder.glob("*.tgz")
    return archive


def read_vendored(path: Path) -> bytes:
    """The file's content, unpacked."""
    content = path.read_bytes()
    return gzip.decompress(content) if path.suffix == ".gz" else content


def _write(file: VendoredFile, archive: tarfile.TarFile) -> VendoredFile:
    path = ROOT / file.path
    content = _made(file, archive) if file.source else read_vendored(path)
    digest = _checked(file.path, content, file.sha512)
    # Another zlib would make other bytes of the same file.
    if not path.exists() or read_vendored(path) != content:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)
    return file.model_copy(update={"sha512": digest})


def _made(file: VendoredFile, archive: tarfile.TarFile) -> bytes:
    """The package's file with its words replaced. Raises NotAsLocked where it lacks the file or a word."""
    member = archive.extractfile(f"package/{file.source}")
    if member is None:
        raise NotAsLocked(f"{file.source} is not a file of its package.")
    content = member.read()
    for old, new in file.replace.items():
        if old.encode() not in content:
            raise NotAsLocked(f"{file.source} has no {old!r} to replace.")
        content = content.replace(old.encode(), new.encode())
    return content + file.append.encode()


def _checked(name: str, content: bytes, expected: str) -> str:
    found = sha512(content)
    if expected and found != expected:
        raise NotAsLocked(f"{name} has the digest {found}; the lock says {expected}.")
    return found


def main() -> int:
    """Bring every package. To take a new version, empty its digests in the lock: they are filled in."""
    try:
        lock = Lock(packages=[bring(package) for package in read_lock().packages])
    except NotAsLocked as error:
        sys.stderr.write(f"{error}\n")
        return 1
    LOCK.write_text(json.dumps(lock.model_dump(exclude_defaults=True), indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
