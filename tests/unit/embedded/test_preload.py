"""A part of the service is loaded first, and runs with what it is told then."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from gaitway.service.embedded.processes import ServerProcess

PART = """
import os, sys

print("loaded", flush=True)

def main():
    print(sys.argv[1:], os.environ["GAITWAY_TOLD"], os.environ["GAITWAY_KNOWN"])
"""


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    (tmp_path / "part.py").write_text(PART)
    code = f"import sys; sys.path.append({str(tmp_path)!r}); from gaitway.service.embedded import preload; "
    return [sys.executable, "-c", f"{code}preload.main(sys.argv[1:])", "-m", "part", "--port", "1"]


def test_it_is_loaded_before_it_is_told_and_runs_then(command: list[str]) -> None:
    with subprocess.Popen(
        command,
        env={**os.environ, "GAITWAY_KNOWN": "a", "GAITWAY_TOLD": "not yet"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as part:
        assert part.stdout is not None
        assert part.stdout.readline() == "loaded\n"
        said, _ = part.communicate(json.dumps({"GAITWAY_TOLD": "b"}))
    assert (part.returncode, said) == (0, "['--port', '1'] b a\n")


@pytest.mark.extra
def test_it_does_not_run_where_its_launcher_says_nothing(command: list[str]) -> None:
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "loaded\n")


def test_what_is_told_to_a_process_that_has_ended_is_lost(tmp_path: Path) -> None:
    process = ServerProcess("part", tmp_path)
    process.start([sys.executable, "-c", "input()"], os.environ, takes_input=True)
    pid = process.pid
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
    process.send_input("too late")
    assert process.status == -signal.SIGKILL
    process.stop(grace_s=0)
