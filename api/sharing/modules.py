"""JavaScript modules of the page inside one HTML file, which no server stands behind."""

import json
import re
from base64 import b64encode
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from posixpath import dirname, join, normpath

from api.page_files import page_files

_IMPORTED = re.compile(r"""(?<=\bfrom)(\s*)["'](\.[^"']+)["']""")


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
