import os
import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux ties a process to its parent")

# The child holds the write end of the pipe; the read end sees its end as soon as nobody holds it.
_CHILD = """
import os, signal
from worker.host.processes import die_with_parent
die_with_parent()
os.write(1, b"ready")
signal.pause()
"""
_PARENT = """
import os, signal, subprocess, sys
variables = {**os.environ, "GAITWAY_PARENT": str(os.getpid())}
child = subprocess.Popen([sys.executable, "-c", sys.argv[1]], env=variables)
signal.pause()
"""


def test_a_process_dies_with_its_parent_however_that_dies() -> None:
    read_end, write_end = os.pipe()
    parent = subprocess.Popen([sys.executable, "-c", _PARENT, _CHILD], stdout=write_end)
    os.close(write_end)
    with os.fdopen(read_end, "rb") as pipe:
        assert pipe.read(5) == b"ready"
        parent.kill()
        parent.wait(10)
        # Returns only when the child is gone, too; the test's timeout would tell.
        assert pipe.read() == b""


def test_a_process_whose_parent_has_gone_already_ends_at_once() -> None:
    # 2**22 is the highest process number that Linux gives.
    child = subprocess.run(
        [sys.executable, "-c", _CHILD],
        env={**os.environ, "GAITWAY_PARENT": str(2**22 + 1)},
        check=False,
        timeout=30,
    )
    assert child.returncode == -signal.SIGKILL
