"""How much memory a training may take, on machines and in containers that are made of files here."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from worker.host.memory import MemoryWatch, allowed_bytes, kernel_kills, memory_of, sacrifice

_GIB = 2**30


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A machine with 16 GiB and no control groups."""
    put(tmp_path, "proc/meminfo", f"MemTotal: {16 * 2**20} kB\nMemFree: 0 kB\n")
    put(tmp_path, "proc/vmstat", "nr_free_pages 1\noom_kill 3\n")
    return tmp_path


def put(root: Path, name: str, text: str) -> None:
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    (root / name).write_text(text)


def put_process(root: Path, pid: int, group: int, gib: float) -> None:
    put(root, f"proc/{pid}/stat", f"{pid} (python) S 1 {group} {group} 0")
    put(root, f"proc/{pid}/status", f"Name: python\nRssAnon:\t{int(gib * 2**20)} kB\n")


def test_a_training_may_take_what_the_machine_has_less_a_reserve(root: Path) -> None:
    assert allowed_bytes(None, root) == 16 * _GIB - int(0.05 * 16 * _GIB)
    put(root, "proc/meminfo", f"MemTotal: {4 * 2**20} kB\n")
    assert allowed_bytes(None, root) == 3.5 * _GIB
    assert allowed_bytes(_GIB, root) == _GIB
    put(root, "proc/meminfo", f"MemTotal: {2**19} kB\n")  # Half, where the reserve would be all of it.
    assert allowed_bytes(None, root) == _GIB / 4


@pytest.mark.parametrize("place", ["sys/fs/cgroup/memory.max", "sys/fs/cgroup/memory/memory.limit_in_bytes"])
def test_a_container_has_what_it_was_given(root: Path, place: str) -> None:
    put(root, place, f"{2 * _GIB}\n")
    assert allowed_bytes(None, root) == 1.5 * _GIB


def test_the_narrowest_control_group_counts(root: Path) -> None:
    put(root, "proc/self/cgroup", "0::/outer/inner\n")
    put(root, "sys/fs/cgroup/outer/memory.max", f"{8 * _GIB}\n")
    put(root, "sys/fs/cgroup/outer/inner/memory.max", "max\n")
    assert allowed_bytes(None, root) == 7.5 * _GIB


def test_kills_are_those_of_the_container_where_it_counts_them(root: Path) -> None:
    assert kernel_kills(root) == 3
    put(root, "proc/self/cgroup", "0::/\n")
    put(root, "sys/fs/cgroup/memory.events", "max 9\noom 1\noom_kill 1\n")
    assert kernel_kills(root) == 1


def test_all_processes_of_a_training_count_together(root: Path) -> None:
    now = 0.0
    watch = MemoryWatch(2 * _GIB, root, lambda: now)
    put_process(root, 10, 10, 1.5)
    put_process(root, 11, 10, 1.0)
    put_process(root, 12, 12, 9.0)
    assert watch.what_is_wrong(10) is None  # The leader alone is looked at each time, all once a second.
    now = 1.0
    told = watch.what_is_wrong(10)
    assert told is not None
    assert told.startswith("The training took 2.5 GiB of the worker's memory and was ended: ")
    assert "GAITWAY_MEMORY_LIMIT allows 2.0 GiB. Lower num_envs" in told


def test_a_kill_for_memory_is_remembered_while_its_process_is_being_found_dead(root: Path) -> None:
    now = 0.0
    watch = MemoryWatch(_GIB, root, lambda: now)
    assert not watch.ran_out()
    put(root, "proc/vmstat", "oom_kill 4\n")
    now = 1.0
    assert watch.what_is_wrong(10) is None
    assert watch.ran_out()
    now = 2.0
    watch.what_is_wrong(10)
    now = 3.0
    watch.what_is_wrong(10)
    assert not watch.ran_out()  # It was of another process, some seconds ago.


def test_the_kernel_takes_a_sacrificed_process_first() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        sacrifice(child.pid)
        assert Path(f"/proc/{child.pid}/oom_score_adj").read_text() == "1000\n"
    sacrifice(child.pid)  # It has ended.
    assert memory_of(child.pid) == 0
    assert memory_of(os.getpid()) > 2**20
