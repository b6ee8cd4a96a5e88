"""What a worker without a job prepares, seen from outside: a process that it starts and ends."""

import os
import sys
import time
from pathlib import Path

import pytest

from core.errors import Misconfigured
from worker.main import check_prepared
from worker.preparation.programs import IdlePreparation

# Adds a line to a file and stays; with `ends` it ends at once.
PROGRAM = """
import os, sys, time
with open(sys.argv[1], "a") as file:
    print(os.getpid(), *sys.argv[3:], file=file, flush=True)
if sys.argv[2] == "stays":
    time.sleep(600)
"""


def preparation(file: Path, how: str, environments: tuple[str, ...] = ("ant",)) -> IdlePreparation:
    return IdlePreparation("cpu", environments, (sys.executable, "-c", PROGRAM, str(file), how))


def lines(file: Path, number: int) -> list[list[str]]:
    """The first lines of the file, once they are there."""
    deadline = time.monotonic() + 30
    while (found := file.read_text().splitlines() if file.exists() else []) == [] or len(found) < number:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return [line.split() for line in found]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "started"


def test_it_ends_with_all_its_processes_when_a_job_comes_and_starts_again(file: Path) -> None:
    one = preparation(file, "stays")
    one.go_on()
    one.go_on()
    ((pid, device, slot),) = lines(file, 1)
    assert device == "cpu"
    assert slot.startswith("cpu-")
    one.stop()
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid), 0)
    one.go_on()
    assert len(lines(file, 2)) == 2
    one.stop()


def test_it_is_not_started_again_once_it_has_come_to_its_end(file: Path) -> None:
    one = preparation(file, "ends")
    one.go_on()
    ((pid, *_),) = lines(file, 1)
    os.waitid(os.P_PID, int(pid), os.WEXITED | os.WNOWAIT)
    one.stop()
    one.go_on()
    one.stop()
    assert len(lines(file, 1)) == 1


def test_without_environments_nothing_is_started(file: Path) -> None:
    one = preparation(file, "stays", ())
    one.go_on()
    one.stop()
    assert not file.exists()


def test_an_environment_that_there_is_not_is_a_wrong_setting() -> None:
    with pytest.raises(Misconfigured, match=r"^GAITWAY_PREPARE: .*Did you mean 'ant'\?"):
        check_prepared(["humanoid", "antt"])


def test_it_gets_no_secret_but_those_of_the_object_store(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """L9: it had the worker's whole environment."""
    secrets = (
        "GITHUB_TOKEN",
        "AWS_SECRET_ACCESS_KEY",
        "WANDB_API_KEY",
        "GAITWAY_WANDB_API_KEY",
        "MY_PASSWORD",
    )
    for name in secrets:
        monkeypatch.setenv(name, "secret")
    monkeypatch.setenv("GAITWAY_S3_SECRET_KEY", "the store's")
    program = "import os, sys; open(sys.argv[1] + '.part', 'w').write(str(dict(os.environ)));"
    program += "os.rename(sys.argv[1] + '.part', sys.argv[1])"
    one = IdlePreparation("cpu", ("ant",), (sys.executable, "-c", program, str(file)))
    one.go_on()
    lines(file, 1)
    said = file.read_text()
    one.stop()
    assert "GAITWAY_S3_SECRET_KEY" in said
    assert not [name for name in secrets if f"'{name}'" in said]


def test_a_failure_is_tried_again_after_a_pause(file: Path) -> None:
    """One collision at a lock ended the preparation for good."""
    now = 1000.0
    command = (sys.executable, "-c", PROGRAM + "sys.exit(1)", str(file), "fails")
    one = IdlePreparation("cpu", ("ant",), command, lambda: now)
    one.go_on()
    ((pid, *_),) = lines(file, 1)
    os.waitid(os.P_PID, int(pid), os.WEXITED | os.WNOWAIT)
    one.go_on()
    one.go_on()
    assert not one.is_running
    now += 60.0
    one.go_on()
    assert len(lines(file, 2)) == 2
    one.stop()
