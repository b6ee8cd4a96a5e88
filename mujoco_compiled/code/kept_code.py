"""Code that was made before, in a folder that processes share."""

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path

_GENERATOR = Path(__file__).parent.parent
_folder: Path | None = None


def keep_code(folder: Path) -> None:
    """Keep the code that engines make from now on in this folder."""
    global _folder
    folder.mkdir(parents=True, exist_ok=True)
    _folder = folder


def kept(described: str, make: Callable[[], bytes]) -> bytes:
    """The code of this description, made only if nothing was kept under it.

    described: all that the code depends on besides the generator and its compiler.
    """
    if _folder is None:
        return make()
    file = _folder / hashlib.sha256(f"{_generator()} {described}".encode()).hexdigest()
    try:
        return file.read_bytes()
    except FileNotFoundError:
        code = make()
    # Another process may make the same code at the same time: each file appears whole, and both are equal.
    with tempfile.NamedTemporaryFile(dir=_folder, delete=False) as part:
        part.write(code)
    os.replace(part.name, file)
    return code


@cache
def _generator() -> str:
    """Differs wherever another generator or compiler might make other code."""
    digest = hashlib.sha256(version("llvmlite").encode())
    for file in sorted(set(_GENERATOR.rglob("*.py")) - set((_GENERATOR / "tests").rglob("*"))):
        digest.update(file.read_bytes())
    return digest.hexdigest()
