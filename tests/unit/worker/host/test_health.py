"""The health check of a container: of one process, and of a fleet."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from worker.host.health import begin_fleet, longest_silence_s, show_life


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "alive[1]"  # Read as a pattern, it would name another file.


def is_healthy(file: Path) -> bool:
    environment = {**os.environ, "GAITWAY_ALIVE_FILE": str(file)}
    command = [sys.executable, "-m", "worker.host.health"]
    return subprocess.run(command, env=environment, check=False).returncode == 0


def silent_for(file: Path, seconds: float) -> None:
    file.touch()
    os.utime(file, (time.time() - seconds, time.time() - seconds))


def test_a_process_is_healthy_for_a_minute_after_each_sign_of_life(file: Path) -> None:
    assert not is_healthy(file)
    show_life(file)
    assert is_healthy(file)
    silent_for(file, 61)
    assert not is_healthy(file)


def test_a_fleet_is_as_healthy_as_its_most_silent_member(file: Path) -> None:
    first, second = begin_fleet(file, 2)
    assert is_healthy(file)
    silent_for(first, 61)
    show_life(second)
    assert not is_healthy(file)
    show_life(first)
    assert is_healthy(file)


def test_a_member_that_has_shown_no_life_is_silent_since_the_fleet_began(file: Path) -> None:
    first, second = begin_fleet(file, 2)
    silent_for(second, 61)  # As it is when a minute has gone by.
    show_life(first)
    assert not is_healthy(file)


def test_members_of_an_earlier_fleet_are_forgotten(file: Path) -> None:
    for old in begin_fleet(file, 3):
        silent_for(old, 1000)
    begin_fleet(file, 1)
    assert longest_silence_s(file) < 60
