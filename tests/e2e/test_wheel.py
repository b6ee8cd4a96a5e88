"""The wheel puts the package `gaitway` into a user's environment, and nothing that the service needs."""

import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.e2e.installed import ROOT, Installed


def test_the_wheel_holds_the_client_alone(installed: Installed) -> None:
    with zipfile.ZipFile(installed.wheel) as archive:
        files = [Path(name).parts for name in archive.namelist()]
    assert {parts[0] for parts in files if not parts[0].endswith(".dist-info")} == {"gaitway"}
    held = {parts[1].removesuffix(".py") for parts in files if parts[0] == "gaitway"}
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    [checked] = [contract for contract in contracts if contract["name"].startswith("The wheel's modules")]
    # Of these, import-linter knows that they need no other code of this repository.
    assert {f"gaitway.{name}" for name in held - {"__init__"}} == set(checked["source_modules"])


def test_the_wheel_brings_no_top_level_package_but_its_own(installed: Installed, tmp_path: Path) -> None:
    program = (
        "import importlib.util, gaitway\n"
        "for name in gaitway.__all__: getattr(gaitway, name)\n"
        "names = ('api', 'core', 'worker', 'gaitway.service', 'brax', 'flax', 'mujoco')\n"
        "print([name for name in names if importlib.util.find_spec(name)])"
    )
    done = installed.python("-c", program, cwd=tmp_path)
    assert (done.stdout, done.stderr) == ("[]\n", "")


def test_the_cli_shows_commands_of_the_service_only_where_it_is(installed: Installed, tmp_path: Path) -> None:
    program = "from gaitway.cli.main import app; app()"
    (tmp_path / "core.py").write_text("raise AssertionError('this is a module of the user')")
    shown = installed.python("-c", program, "--help", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    commands = {line.split()[0] for line in shown.stdout.partition("Commands:")[2].splitlines() if line}
    assert {"submit", "watch", "models", "import"} <= commands
    assert not {"api", "check", "demo", "doctor", "up", "worker"} & commands


@pytest.mark.parametrize(
    "arguments",
    [["up", "--port", "8000"], ["worker", "--help"]],
    ids=lambda arguments: arguments[0],
)
def test_a_command_of_the_service_says_where_the_service_is(
    installed: Installed, tmp_path: Path, arguments: list[str]
) -> None:
    done = installed.python("-c", "from gaitway.cli.main import app; app()", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert f"`gaitway {arguments[0]}` is a command of the service" in done.stderr
    assert "git clone" in done.stderr
    assert "Traceback" not in done.stderr
