"""The kernel keeps a training to its memory, where this machine lets a test make a control group."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from worker.host.cgroup import memory_group
from worker.host.memory import MemoryWatch

_TOP = Path("/sys/fs/cgroup")
_LIMIT = 64 * 2**20
# A child that takes memory once it is told, while its parent waits: both are of the group.
_GREEDY = "import subprocess, sys; input(); subprocess.run([sys.executable, '-c', 'bytearray(2**28)'])"
_SITS = "input()"
# In a folder of control groups of the test's own, it stands in one and starts the other beside itself.
_WORKER = """
import subprocess, sys
from pathlib import Path
from worker.host.cgroup import memory_group
from worker.host.memory import MemoryWatch
child = subprocess.Popen([sys.executable, "-c", sys.argv[1]], stdin=subprocess.PIPE, start_new_session=True)
with memory_group(child.pid, int(sys.argv[2])) as group:
    watch = MemoryWatch(2**40, group=group)
    print(Path(f"/proc/{child.pid}/cgroup").read_text().split("::")[-1].strip(), flush=True)
    if len(sys.argv) > 3:
        child.stdin.write(b"\\n")
        child.stdin.close()
        child.wait(60)
    print(group.ran_out(), watch.ran_out(), flush=True)
print(child.wait(10))
"""


def no_groups_here() -> str | None:
    """Why this machine lets nobody make a group that is bound in its memory; None where it does."""
    if not (_TOP / "cgroup.controllers").exists():
        return "the control groups of this machine are not, or not only, of version 2"
    if "memory" not in (_TOP / "cgroup.subtree_control").read_text().split():
        return "this machine's control groups do not count memory"
    return None if os.access(_TOP, os.W_OK) else "this user, or this container, may make no control group"


@pytest.fixture
def delegated() -> Iterator[Path]:
    """A folder of groups that is a worker's to write, with the group `worker` in it."""
    if (why := no_groups_here()) is not None:
        pytest.skip(why)
    folder = _TOP / f"gaitway-test-{os.getpid()}"
    (folder / "worker").mkdir(parents=True)
    yield folder
    (folder / "worker").rmdir()
    folder.rmdir()


def work(delegated: Path, program: str, *arguments: str) -> list[str]:
    """The lines that a worker in that group prints."""
    move = f"open('{delegated}/worker/cgroup.procs', 'w').write('0')"
    done = subprocess.run(
        [sys.executable, "-c", f"{move}\n{_WORKER}", program, str(_LIMIT), *arguments],
        capture_output=True,
        text=True,
        check=True,
    )
    return [line for line in done.stdout.splitlines() if "memory_group" not in line]


def test_the_kernel_ends_a_training_with_all_that_it_started_and_says_so(delegated: Path) -> None:
    group, told, status = work(delegated, _GREEDY, "go")
    assert group.startswith(f"/{delegated.name}/gaitway-training-")
    assert told == "True True"
    assert int(status) == -signal.SIGKILL
    assert [path.name for path in delegated.iterdir() if path.is_dir()] == ["worker"]


def test_at_the_end_nothing_is_left_and_nobody_was_out_of_memory(delegated: Path) -> None:
    (delegated / "gaitway-training-1").mkdir()  # A killed supervisor's.
    _, told, status = work(delegated, _SITS)
    assert (told, int(status)) == ("False False", -signal.SIGKILL)
    assert [path.name for path in delegated.iterdir() if path.is_dir()] == ["worker"]


@pytest.mark.parametrize("controllers", [None, "cpu pids", "memory"])
def test_where_no_group_can_be_made_a_training_runs_as_before(
    tmp_path: Path, controllers: str | None
) -> None:
    """Of version 1; without the controller, in a group that has processes; in the outermost group."""
    top = tmp_path / "sys/fs/cgroup"
    for path, text in {
        tmp_path / "proc/self/cgroup": "0::/\n" if controllers == "memory" else "0::/outer/worker\n",
        top / "outer/cgroup.procs": "1\n",
        top / "outer/memory.max": "max\n",
        **({} if controllers is None else {top / "cgroup.controllers": controllers}),
    }.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    with memory_group(os.getpid(), _LIMIT, tmp_path) as group:
        assert group.folder is None
        assert not group.ran_out()
        assert not MemoryWatch(_LIMIT, tmp_path, group=group).ran_out()
    assert sorted(path.name for path in (top / "outer").iterdir()) == ["cgroup.procs", "memory.max"]
