"""Builds the documentation as a site that needs no network: `./run site [--out DIR]`.

The pages are the repository's own. Added are a reference of the client, from its docstrings, and the HTTP
interface, from the service's OpenAPI document.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

_ROOT = Path(__file__).parents[2]
_REFERENCE = """# The client, every method

How it is used: [client.md](client.md). `gaitway.AsyncClient` has the same methods, to be awaited.

::: gaitway.client.Client
    options:
      inherited_members: true

::: gaitway.schema

::: gaitway.errors
"""
_INTERFACE = """<!doctype html>
<html lang="en">
<head>
  <meta charset="utf-8">
  <meta name="viewport" content="width=device-width, initial-scale=1">
  <title>Gaitway: the HTTP interface</title>
  <link rel="stylesheet" href="swagger-ui.css">
  <script src="swagger-ui.js" defer></script>
  <script src="document.js" defer></script>
</head>
<body><p><a href="../index.html">Gaitway</a></p><div id="docs"></div></body>
</html>
"""
# A page that is opened as a file may not fetch, so the document is part of the script.
_SHOW = """SwaggerUIBundle({dom_id: "#docs", spec: %s, validatorUrl: null, supportedSubmitMethods: [],
  defaultModelsExpandDepth: 0});
"""
_SHIM = re.compile(r'<script src="https://[^"]*iframe-worker[^"]*"[^>]*></script>')


def build(out: Path) -> int:
    """Write the site to the folder, which is replaced; the exit status of Zensical."""
    with tempfile.TemporaryDirectory(prefix="gaitway-site-") as folder:
        work = Path(folder)
        _gather(work / "pages")
        shutil.copy(_ROOT / "zensical.toml", work)
        command = [sys.executable, "-m", "zensical", "build", "--strict"]
        done = subprocess.run(command, cwd=work, check=False)
        if done.returncode == 0:
            _ask_nobody_else(work / "site")
            shutil.rmtree(out, ignore_errors=True)
            shutil.move(work / "site", out)
    return done.returncode


def _gather(pages: Path) -> None:
    """Lay out the pages as in the repository, so that their links hold; the README is the first page."""
    for name in ("docs", "examples"):
        shutil.copytree(_ROOT / name, pages / name)
    for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"):
        shutil.copy(_ROOT / name, pages)
    (pages / "README.md").rename(pages / "index.md")
    (pages / "mujoco_compiled").mkdir()
    shutil.copy(_ROOT / "mujoco_compiled" / "README.md", pages / "mujoco_compiled" / "index.md")
    for page in pages.rglob("*.md"):
        # The site's theme would fetch Mermaid from another host, so it shows a drawing's text.
        text = page.read_text().replace("README.md", "index.md").replace("```mermaid", "```text")
        page.write_text(text)
    (pages / "docs" / "client_reference.md").write_text(_REFERENCE)
    http = pages / "interface"
    http.mkdir()
    (http / "index.html").write_text(_INTERFACE)
    (http / "document.js").write_text(_SHOW % _document())
    for name in ("swagger-ui.css", "swagger-ui.js"):
        shutil.copy(_ROOT / "api" / "pages" / "vendor" / name, http)


def _document() -> str:
    """The service's OpenAPI document, from a process of its own: only the API knows FastAPI."""
    program = "import json; from api.app import interface; print(json.dumps(interface().openapi()))"
    return subprocess.check_output([sys.executable, "-c", program], cwd=_ROOT, text=True)


def _ask_nobody_else(site: Path) -> None:
    """Take out a script of another host, by which the search would work in pages opened as files."""
    for page in site.rglob("*.html"):
        page.write_text(_SHIM.sub("", page.read_text()))


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="./run site", description="Build the documentation as a site.")
    parser.add_argument("--out", type=Path, default=Path("site"), metavar="DIR")
    chosen = parser.parse_args(arguments)
    status = build(chosen.out)
    if status == 0:
        sys.stdout.write(
            f"The site is in {chosen.out}: open its index.html, or serve it, which its search needs:\n"
            f"python -m http.server --directory {chosen.out}\n"
        )
    return status


if __name__ == "__main__":
    sys.exit(main())
