"""Prints the test files that import what has changed since `main`, themselves or through others.

A test does not import the processes that it starts or the files that it reads: `./run test` covers those.
"""

import re
import subprocess
from collections.abc import Iterable
from pathlib import Path

import grimp

_PACKAGES = ("api", "bench", "core", "gaitway", "mujoco_compiled", "tests", "worker")
_FIXTURE = re.compile(r"^@pytest\.fixture.*\n(?:async )?def (\w+)", re.MULTILINE)


def changed_files() -> set[Path]:
    """Those that differ from where this branch left `main`, and those that git does not know yet."""
    base = _git("merge-base", "main", "HEAD") or ["HEAD"]
    names = [*_git("diff", "--name-only", *base), *_git("ls-files", "--others", "--exclude-standard")]
    return {Path(name) for name in names}


def tests_of(changed: Iterable[Path]) -> set[Path]:
    """The files of tests whose imports, or whose fixtures' imports, reach one of the files."""
    graph = grimp.build_graph(*_PACKAGES, cache_dir=None)
    reached = set[str]()
    for file in changed:
        if module := _module(file, graph.modules):
            whole = file.suffix != ".py"  # Who in the package reads it, nobody says.
            reached |= {module, *(graph.find_descendants(module) if whole else ())}
            reached |= graph.find_downstream_modules(module, as_package=whole)
    files = [Path(*module.split(".")).with_suffix(".py") for module in reached if ".tests." in f".{module}"]
    found = {file for file in files if file.name.startswith("test_") and file.exists()}
    for file in files:
        if file.name == "conftest.py":
            found |= _users(file)
    return found


def _users(conftest: Path) -> set[Path]:
    """The files of tests below it that name one of its fixtures."""
    fixtures = _FIXTURE.findall(conftest.read_text())
    names = re.compile(rf"\b({'|'.join(fixtures)})\b")
    return {file for file in conftest.parent.rglob("test_*.py") if names.search(file.read_text())}


def _module(file: Path, modules: set[str]) -> str | None:
    """The module; the package of a file that is none; None outside the packages."""
    for path in (file.with_suffix(""), *file.parents):
        if (name := ".".join(path.parts).removesuffix(".__init__")) in modules:
            return name
    return None


def _git(*arguments: str) -> list[str]:
    return subprocess.run(["git", *arguments], stdout=subprocess.PIPE, text=True).stdout.split("\n")[:-1]


if __name__ == "__main__":
    print(*sorted(map(str, tests_of(changed_files()))), sep="\n")
