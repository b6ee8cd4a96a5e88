"""The service from its wheel alone, as a user starts it: installed by name, in folders that know no clone.

Needs a package index, or uv's cache, for what the extra `up` asks for.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import uuid
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import psutil
import pytest

from gaitway.service.embedded.processes import free_ports
from tests.e2e.installed import ROOT, build_wheel

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(1200),
    pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc"),
]

OWN_JOB = {
    "kind": "train",
    "name": "my own",
    "environment": "ant",
    "algorithm": {"kind": "ppo", "num_timesteps": 20_000},
}
_MARK = "GAITWAY_TEST_WHEEL"


@dataclass(frozen=True)
class User:
    """Somebody with a home, where an environment and an empty folder to work in lie."""

    home: Path
    mark: str = field(default_factory=lambda: uuid.uuid4().hex)

    @property
    def folder(self) -> Path:
        return self.home / "work"

    def surroundings(self) -> dict[str, str]:
        kept = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith(("GAITWAY_", "PYTHON", "COV_", "XDG_"))
        }
        return {**kept, "HOME": str(self.home), _MARK: self.mark}

    def start(self, *command: str) -> "subprocess.Popen[str]":
        program = [str(self.home / "venv" / "bin" / command[0]), *command[1:]]
        return subprocess.Popen(
            program, cwd=self.folder, env=self.surroundings(), stdin=-3, stdout=-1, stderr=-1, text=True
        )

    def run(self, *command: str) -> tuple[int, str, str]:
        """Its exit status, and what it prints on both streams."""
        with self.start(*command) as process:
            out, err = process.communicate(timeout=900)
        return process.returncode, out, err

    def family(self) -> list[psutil.Process]:
        """The living processes of this user, by environment or by folder, as servers are found."""
        return [process for process in psutil.process_iter() if self._is_ours(process)]

    def _is_ours(self, process: psutil.Process) -> bool:
        try:
            if process.status() == psutil.STATUS_ZOMBIE:
                return False
            traces = (" ".join(process.cmdline()), process.cwd())
            is_marked = process.environ().get(_MARK) == self.mark
            return is_marked or any(str(self.home) in trace for trace in traces)
        except (psutil.NoSuchProcess, psutil.AccessDenied):
            return False


@pytest.fixture(scope="module")
def user(tmp_path_factory: pytest.TempPathFactory) -> Iterator[User]:
    """A user who has installed `gaitway[up]` from a local folder, and has modules of the service's names."""
    home = tmp_path_factory.mktemp("home")
    uv = shutil.which("uv", path=f"{ROOT / '.uv' / 'bin'}:{os.environ['PATH']}")
    if uv is None:
        pytest.skip("There is no uv.")
    index, python = build_wheel(home / "dist").parent, home / "venv" / "bin" / "python"
    subprocess.run([uv, "venv", "--quiet", "--python", sys.executable, home / "venv"], check=True, cwd=home)
    install = [uv, "pip", "install", "--quiet", "--python", python, "--find-links", index, "gaitway[up]"]
    subprocess.run(install, check=True, cwd=home)
    shutil.rmtree(index)
    made = User(home)
    made.folder.mkdir()
    for name in ("api", "core", "worker"):
        (made.folder / f"{name}.py").write_text("raise AssertionError('a module of the user')\n")
    yield made
    for left in made.family():
        left.kill()


@pytest.mark.parametrize("name", ["api", "core", "worker"])
def test_a_users_python_knows_no_module_of_the_service(user: User, name: str) -> None:
    status, _, told = user.run("python", "-P", "-c", f"import gaitway, {name}")
    assert status == 1
    assert f"ModuleNotFoundError: No module named '{name}'" in told


def test_the_demo_leaves_its_files_and_no_process(user: User) -> None:
    status, said, told = user.run("gaitway", "demo", "--timesteps", "100000", "--port", str(free_ports(1)[0]))
    assert status == 0, (said, told)
    assert (user.folder / "gaitway-demo" / "ant-policy").exists()
    assert f"gaitway up --data {user.folder / 'gaitway-demo' / 'data'}" in said
    assert user.family() == []


def test_a_job_of_ones_own_runs_where_the_cli_finds_the_service_by_itself(user: User) -> None:
    port = str(free_ports(1)[0])
    (user.folder / "job.json").write_text(json.dumps(OWN_JOB))
    with user.start("gaitway", "up", "--port", port) as service:
        assert service.stdout is not None
        assert f"http://127.0.0.1:{port} " in service.stdout.readline()
        assert (
            f"Data and logs are in {user.home / '.local' / 'share' / 'gaitway'}." in service.stdout.readline()
        )
        status, said, told = user.run("gaitway", "submit", "-f", "job.json", "--watch")
        assert status == 0, (said, told)
        _, listed, _ = user.run("gaitway", "jobs")
        assert re.search(r"succeeded.*my own|my own.*succeeded", listed), listed
        service.send_signal(signal.SIGINT)
        _, told = service.communicate(timeout=60)
    assert service.returncode == 0, told
    assert user.family() == []
    left = (user.home / ".local" / "share" / "gaitway" / "running").rglob("*")
    assert [path for path in left if path.is_file()] == []
    assert sorted(path.name for path in user.folder.glob("*")) == sorted(
        ["api.py", "core.py", "gaitway-demo", "job.json", "worker.py"]
    )
