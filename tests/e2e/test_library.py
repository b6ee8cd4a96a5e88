"""The physics library from its folder alone: its wheel, in an environment that has nothing of the service."""

import shutil
import subprocess
import tomllib
import zipfile
from pathlib import Path

import pytest

from mujoco_compiled.tests.test_face import POLE, check_told, readmes_program
from tests.e2e.installed import ROOT, Installed, install

_FOLDER = "mujoco_compiled"


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = tmp_path_factory.mktemp("library")
    for name in _listed():
        target = folder / "copy" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / _FOLDER / name, target)
    return install(folder, project=folder / "copy")


def test_its_wheel_has_its_code_and_its_licence(library: Installed) -> None:
    with zipfile.ZipFile(library.wheel) as archive:
        names = archive.namelist()
    listed = [name for name in _listed() if not name.startswith("tests/")]
    code = {f"{_FOLDER}/{name}" for name in listed if name.endswith(".py") or name == "py.typed"}
    assert {name for name in names if ".dist-info/" not in name} == code
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert (ROOT / _FOLDER / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()


def test_its_pages_program_runs_without_the_service(library: Installed, tmp_path: Path) -> None:
    (tmp_path / "body.xml").write_text(POLE)
    for name in ("api", "core", "gaitway", "worker"):
        (tmp_path / f"{name}.py").write_text("raise AssertionError('a module of the user')")
    (tmp_path / "program.py").write_text(readmes_program())
    done = library.python("program.py", cwd=tmp_path)
    assert (done.stderr, done.returncode) == ("", 0)
    check_told(done.stdout)


def test_it_asks_for_what_the_service_asks_for() -> None:
    whole = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    alone = tomllib.loads((ROOT / _FOLDER / "pyproject.toml").read_text())["project"]
    assert set(alone["dependencies"]) <= {*whole["worker"], *whole["compiled"]}
    assert alone["optional-dependencies"]["cuda"] == whole["cuda"]


def _listed() -> list[str]:
    """Its files, as a clone has them."""
    listed = subprocess.check_output(
        ["git", "-C", str(ROOT / _FOLDER), "ls-files", "-co", "--exclude-standard"], text=True
    )
    return [name for name in listed.splitlines() if (ROOT / _FOLDER / name).exists()]
