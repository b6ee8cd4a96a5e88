"""The wheel puts the package `gaitway` into a user's environment, and no other name."""

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from tests.e2e.installed import ROOT, Installed

# These work only in a clone, or in the images.
_CLONES_OWN = {f"gaitway/service/{name}.py" for name in ("compose", "settings_page", "site", "vendoring")}
# These are of the physics library alone.
_LIBRARYS_OWN = tuple(
    f"mujoco_compiled/{name}" for name in ("LICENSE", "README.md", "pyproject.toml", "tests/")
)


def test_the_wheel_holds_the_service_in_a_folder_of_its_own(installed: Installed) -> None:
    with zipfile.ZipFile(installed.wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    packages = ("api", "core", "gaitway", "mujoco_compiled", "worker")
    listed = subprocess.check_output(
        ["git", "-C", str(ROOT), "ls-files", "-co", "--exclude-standard", *packages]
    )
    files = {name for name in listed.decode().splitlines() if (ROOT / name).exists()}
    files = {name for name in files - _CLONES_OWN if not name.startswith(_LIBRARYS_OWN)}
    assert held == {name if name.startswith("gaitway/") else f"gaitway/_service/{name}" for name in files}


def test_a_users_code_needs_no_module_of_the_service(installed: Installed) -> None:
    with zipfile.ZipFile(installed.wheel) as archive:
        files = [Path(name).parts for name in archive.namelist()]
    held = {parts[1].removesuffix(".py") for parts in files if parts[0] == "gaitway"}
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    [checked] = [contract for contract in contracts if contract["name"].startswith("The wheel's modules")]
    # Of these, import-linter knows that they need no other code of this repository. What packages with terms
    # of their own import is the service's.
    others = held - {"__init__", "_service", "service", "environments"}
    assert {f"gaitway.{name}" for name in others} == set(checked["source_modules"])


def test_the_wheel_brings_no_top_level_package_but_its_own(installed: Installed, tmp_path: Path) -> None:
    program = (
        "import importlib.util, gaitway\n"
        "for name in gaitway.__all__: getattr(gaitway, name)\n"
        "names = ('api', 'core', 'worker', 'brax', 'flax', 'mujoco')\n"
        "print([name for name in names if importlib.util.find_spec(name)])"
    )
    done = installed.python("-c", program, cwd=tmp_path)
    assert (done.stdout, done.stderr) == ("[]\n", "")


def test_a_process_of_the_service_and_its_children_import_its_packages(
    installed: Installed, tmp_path: Path
) -> None:
    for name in ("api", "core", "worker"):
        (tmp_path / f"{name}.py").write_text("raise AssertionError('a module of the user')")
    child = "import api, core, worker; print(core.__file__)"
    program = (
        "import subprocess, sys; from gaitway.service.installed import use_code; use_code()\n"
        f"import api, core, worker; print(core.__file__, flush=True)\n"
        f"subprocess.run([sys.executable, '-c', {child!r}])"
    )
    done = installed.python("-c", program, cwd=tmp_path)
    assert done.stderr == ""
    [parents, childs] = map(Path, done.stdout.splitlines())
    assert parents == childs
    assert parents.parts[-4:-1] == ("gaitway", "_service", "core")


def test_the_cli_shows_commands_of_the_service_only_where_it_works(
    installed: Installed, tmp_path: Path
) -> None:
    shown = installed.python("-c", "from gaitway.cli import main; main()", "--help", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    commands = {line.split()[0] for line in shown.stdout.partition("Commands:")[2].splitlines() if line}
    assert {"submit", "watch", "models", "import"} <= commands
    assert not {"api", "check", "demo", "doctor", "up", "worker"} & commands


@pytest.mark.parametrize(
    ("extra", "arguments"),
    [("up", ["up", "--port", "8000"]), ("up", ["demo", "--seed", "1"]), ("worker", ["worker"])],
    ids=lambda part: part[0],
)
def test_a_command_of_the_service_says_how_to_install_it(
    installed: Installed, tmp_path: Path, extra: str, arguments: list[str]
) -> None:
    (tmp_path / "core.py").write_text("raise AssertionError('this is a module of the user')")
    done = installed.python("-P", "-c", "from gaitway.cli import main; main()", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert f"`pip install 'gaitway[{extra}]'` installs it." in done.stderr


def test_the_program_without_its_extra_says_how_to_install_it(tmp_path: Path) -> None:
    program = "import sys; sys.modules['typer'] = None\nfrom gaitway.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, "up"], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.returncode == 1
    assert done.stderr.startswith("gaitway: Only the Python client is installed: `pip install 'gaitway[up]'`")
    assert done.stderr.count("\n") == 1


def test_the_lock_is_made_from_the_ranges_that_the_wheel_asks_for() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = {("", *_range(text)) for text in project["dependencies"]}
    for extra, texts in project["optional-dependencies"].items():
        asked |= {(extra, *_range(text)) for text in texts}
    lock = tomllib.loads((ROOT / "uv.lock").read_text())
    [own] = [package for package in lock["package"] if package["name"] == "gaitway"]
    assert {_locked(required) for required in own["metadata"]["requires-dist"]} == asked


def _range(text: str) -> tuple[str, frozenset[str], SpecifierSet]:
    required = Requirement(text)
    return required.name.lower(), frozenset(required.extras), required.specifier


def _locked(required: dict[str, Any]) -> tuple[str, str, frozenset[str], SpecifierSet]:
    extra = re.search(r"extra == '([\w-]+)'", required.get("marker", ""))
    specifier = SpecifierSet(required.get("specifier", ""))
    return extra[1] if extra else "", required["name"], frozenset(required.get("extras", ())), specifier
