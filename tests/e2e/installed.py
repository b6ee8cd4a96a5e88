"""An environment of a user: the wheel, and what the wheel's extras ask for, and nothing else."""

import os
import re
import subprocess
import sys
import sysconfig
import venv
import zipfile
from dataclasses import dataclass
from importlib.metadata import Distribution, PathDistribution, distribution
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Installed:
    """folder: of the environment. wheel: the file that it was made from."""

    folder: Path
    wheel: Path

    def python(self, *arguments: str, cwd: Path) -> "subprocess.CompletedProcess[str]":
        """Run its Python in a folder of the user's."""
        command = [str(self.folder / "bin" / "python"), *arguments]
        surroundings = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith(("GAITWAY_", "PYTHON", "COV_"))
        }
        return subprocess.run(
            command, cwd=cwd, env=surroundings, capture_output=True, text=True, check=False, timeout=100
        )


def install(folder: Path, *extras: str, project: Path = ROOT) -> Installed:
    """A project's wheel, in an empty environment with the dependencies of these extras.

    No test reaches a package index: the dependencies are links to the files of the environment that runs the
    tests, without its editable installation of the checkout.
    """
    wheel = build_wheel(folder / "dist", project)
    home = folder / "venv"
    venv.create(home, symlinks=True)
    site = Path(sysconfig.get_path("purelib", "venv", {"base": str(home), "platbase": str(home)}))
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)  # as an installer does with a wheel of pure Python
    [metadata] = site.glob("*.dist-info")
    for found in _needed(PathDistribution(metadata), extras).values():
        _link(found, site)
    return Installed(home, wheel)


def build_wheel(folder: Path, project: Path = ROOT) -> Path:
    """The wheel of a project, by default this checkout, built into the folder."""
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=project, check=True, capture_output=True)
    [wheel] = folder.glob("*.whl")
    return wheel


def _needed(package: Distribution, extras: tuple[str, ...]) -> dict[str, Distribution]:
    """By name, whatever the package and its dependencies require with these extras."""
    found: dict[str, Distribution] = {}
    waiting = [(package, ("", *extras))]
    while waiting:
        asking, wanted = waiting.pop()
        for text in asking.requires or ():
            required = Requirement(text)
            marker = required.marker
            if marker is not None and not any(marker.evaluate({"extra": extra}) for extra in wanted):
                continue
            name = re.sub(r"[-_.]+", "-", required.name).lower()
            if name not in found:
                found[name] = distribution(name)
                waiting.append((found[name], ("", *required.extras)))
    return found


def _link(package: Distribution, site: Path) -> None:
    for name in {file.parts[0] for file in package.files or ()} - {"..", "__pycache__"}:
        if not (site / name).exists():
            (site / name).symlink_to(Path(str(package.locate_file(name))))
