"""`./run` where it must refuse, or has nothing to do. (Installing from nothing is what CI does.)"""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def run(
    script: Path, *arguments: str, cwd: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, script, *arguments],
        cwd=cwd,
        env={**os.environ, **environment},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """The script and what it reads, in a folder with a space."""
    folder = tmp_path / "a clone"
    folder.mkdir()
    for name in ("run", "pyproject.toml", "uv.lock"):
        shutil.copy(ROOT / name, folder)
    return folder


def pretend_set_up(clone: Path) -> None:
    """A .venv as a finished start leaves it: stamped, with a Python that says what it was asked."""
    folder = clone / ".venv" / "bin"
    folder.mkdir(parents=True)
    (folder / "python").write_text(
        '#!/bin/sh\necho "asked: $@"; echo "path: $PYTHONPATH$PYTHONDONTWRITEBYTECODE"; pwd\n'
    )
    (folder / "python").chmod(0o755)
    code = (
        "import importlib.machinery as m, sys; run = m.SourceFileLoader('run', sys.argv[1]).load_module(); "
        "print(run.fingerprint())"
    )
    stamp = subprocess.check_output(
        [sys.executable, "-W", "ignore", "-c", code, clone / "run"], text=True
    ).strip()
    (clone / ".venv" / ".gaitway-stamp").write_text(stamp)


def test_help_needs_nothing(clone: Path) -> None:
    done = run(clone / "run", "help")
    assert done.returncode == 0
    assert all(f"./run {name}" in done.stdout for name in ("demo", "up", "test", "check", "bench"))
    assert not (clone / ".venv").exists()


def test_an_unknown_command_is_refused_with_what_there_is(clone: Path) -> None:
    done = run(clone / "run", "tset")
    assert done.returncode == 2
    assert "no './run tset'" in done.stderr
    assert "./run test" in done.stderr


def test_a_second_start_goes_straight_on_from_any_folder(clone: Path, tmp_path: Path) -> None:
    pretend_set_up(clone)
    started = time.monotonic()
    done = run(
        clone / "run",
        "up",
        "--port",
        "8123",
        cwd=tmp_path,
        PYTHONPATH="/elsewhere",
        PYTHONDONTWRITEBYTECODE="1",
    )
    assert time.monotonic() - started < 10  # To set up takes a minute.
    # The user's folder stays the current one; the user's Python set-up does not reach the service.
    asked, path, folder = done.stdout.splitlines()
    assert asked == "asked: -P -m gaitway.service.embedded.up --port 8123"
    assert path == "path: "
    assert Path(folder) == tmp_path


def test_tests_run_in_the_repository(clone: Path, tmp_path: Path) -> None:
    pretend_set_up(clone)
    asked, _, folder = run(clone / "run", "test", "-k", "two words", cwd=tmp_path).stdout.splitlines()
    assert asked.startswith("asked: -m pytest ")
    assert asked.endswith("-k two words")
    assert Path(folder) == clone


def test_without_uv_pip_and_ensurepip_it_says_what_to_install(clone: Path) -> None:
    # A Python that claims to have neither, and no uv on the PATH.
    fake = clone / "bin"
    fake.mkdir()
    for name in ("env", "sh"):
        (fake / name).symlink_to(shutil.which(name) or "/bin/sh")
    code = (
        "import runpy, sys; sys.argv = sys.argv[1:]; "
        "m = runpy.run_path(sys.argv[0], run_name='script'); "
        "m['bring_uv'].__globals__['module_exists'] = lambda name: False; "
        "sys.exit(m['main'](['up']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, clone / "run"],
        env={"PATH": str(fake)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    assert "neither pip nor ensurepip" in done.stderr
    assert "apt-get install -y python3-venv" in done.stderr


def test_an_unfinished_venv_is_removed_before_anything_else(clone: Path) -> None:
    pretend_set_up(clone)
    (clone / ".venv" / ".gaitway-stamp").unlink()
    (clone / ".venv" / ".gaitway-unfinished").touch()
    # A uv that cannot install anything: what is left is what ./run itself did.
    fake = clone / "bin"
    fake.mkdir()
    (fake / "uv").write_text('#!/bin/sh\n[ "$1" = --version ] && echo "uv 0.11.0" && exit 0\nexit 3\n')
    (fake / "uv").chmod(0o755)
    done = run(clone / "run", "up", PATH=f"{fake}:/usr/bin:/bin")
    assert done.returncode == 1
    assert "removing the unfinished .venv" in done.stderr
    assert "could not be made" in done.stderr
    assert not (clone / ".venv").exists()
