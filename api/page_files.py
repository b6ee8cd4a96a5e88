"""The page's files, read once: each with its media type, and compressed where that helps.

Its modules also work inside one HTML file, which no server stands behind: a report.
"""

import gzip
import hashlib
import json
import re
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from hashlib import sha256
from importlib.resources import files
from importlib.resources.abc import Traversable
from posixpath import dirname, join, normpath

_MEDIA_TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "json": "application/json",
    "svg": "image/svg+xml",
    "txt": "text/plain; charset=utf-8",
    "wasm": "application/wasm",
}
_IMPORTED = re.compile(r"""(?<=\bfrom)(\s*)["'](\.[^"']+)["']""")


@dataclass(frozen=True)
class PageFile:
    """A file of the page. stored: its bytes, which are gzip where it is stored compressed."""

    stored: bytes
    media_type: str
    is_stored_compressed: bool = False

    @cached_property
    def content(self) -> bytes:
        """The file itself."""
        return gzip.decompress(self.stored) if self.is_stored_compressed else self.stored

    @cached_property
    def compressed(self) -> bytes:
        """The content as gzip; made when the first browser asks for it."""
        return self.stored if self.is_stored_compressed else gzip.compress(self.stored, mtime=0)


@dataclass(frozen=True)
class PageFiles:
    """All files by their path. version: changes with any of them; it is part of their addresses."""

    version: str
    by_path: Mapping[str, PageFile]


@cache
def page_files() -> PageFiles:
    """The files below `api/pages`; in the HTML, `{version}` becomes the version.

    A file `x.gz` is served as `x`.
    """
    found = dict(_read(files("api") / "pages", ""))
    version = hashlib.sha256(repr(sorted(found.items())).encode()).hexdigest()[:12]
    return PageFiles(
        version,
        {
            path.removesuffix(".gz"): _file(path, _with_version(path, content, version))
            for path, content in found.items()
        },
    )


def _file(path: str, stored: bytes) -> PageFile:
    kind = path.removesuffix(".gz").rpartition(".")[2]
    return PageFile(stored, _MEDIA_TYPES[kind], is_stored_compressed=path.endswith(".gz"))


def _read(folder: Traversable, prefix: str) -> list[tuple[str, bytes]]:
    found: list[tuple[str, bytes]] = []
    for entry in folder.iterdir():
        path = f"{prefix}{entry.name}"
        found += _read(entry, f"{path}/") if entry.is_dir() else [(path, entry.read_bytes())]
    return found


def _with_version(path: str, content: bytes, version: str) -> bytes:
    return content.replace(b"{version}", version.encode()) if path.endswith(".html") else content


@dataclass(frozen=True)
class EmbeddedModules:
    """html: two script elements; policy: sources for `script-src` under which these run, and no others."""

    html: str
    policy: str


@cache
def embedded_modules(*entries: str) -> EmbeddedModules:
    """Modules and all that they import, each as a `data:` address in an import map.

    entries: paths below `api/pages`. A module that is a `data:` address has no folder, so `./` and `../`
    become paths below `api/pages`, which the map knows.
    """
    found: dict[str, str] = {}
    waiting = [*entries]
    while waiting:
        path = waiting.pop()
        if path not in found:
            source, imported = _rooted(path)
            found[path] = f"data:text/javascript;base64,{b64encode(source.encode()).decode()}"
            waiting += imported
    import_map = json.dumps({"imports": found})
    start = "".join(f"import {json.dumps(entry)};" for entry in entries)
    return EmbeddedModules(
        f'<script type="importmap">{import_map}</script><script type="module">{start}</script>',
        f"{_hashed(import_map)} {_hashed(start)} data:",
    )


def _rooted(path: str) -> tuple[str, list[str]]:
    """A module whose imports are paths below `api/pages`, and these paths."""
    imported: list[str] = []

    def root(found: re.Match[str]) -> str:
        imported.append(normpath(join(dirname(path), found[2])))
        return f'{found[1]}"{imported[-1]}"'

    source = page_files().by_path[path].content.decode()
    return _IMPORTED.sub(root, source), imported


def _hashed(source: str) -> str:
    return f"'sha256-{b64encode(sha256(source.encode()).digest()).decode()}'"
