"""An attempt's folder goes with the attempt, however that ends, and with no other."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

from worker.supervision.spool import remove_left_over, spool

# Holds a spool with a checkpoint in it until somebody ends it.
_HOLDER = """
import sys
from pathlib import Path
from worker.supervision.spool import spool
with spool(Path(sys.argv[1])) as folder:
    (folder / "checkpoint").write_text("state")
    print("held", flush=True)
    sys.stdin.read()
"""


def holder(path: Path) -> "subprocess.Popen[bytes]":
    process = subprocess.Popen(
        [sys.executable, "-c", _HOLDER, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"held\n"
    return process


def test_a_spool_is_gone_after_its_attempt(tmp_path: Path) -> None:
    with spool(tmp_path / "spool" / "job.1") as folder:
        (folder / "checkpoint").touch()
    assert list((tmp_path / "spool").iterdir()) == []


def test_the_spool_of_a_killed_attempt_is_removed_and_that_of_a_living_one_is_not(tmp_path: Path) -> None:
    with holder(tmp_path / "job.1") as killed, holder(tmp_path / "job.2") as living:
        killed.send_signal(signal.SIGKILL)
        killed.wait(10)
        assert (tmp_path / "job.1" / "checkpoint").exists()
        remove_left_over(tmp_path)
        assert {file.name for file in tmp_path.iterdir()} == {"job.2", "job.2.lock", "job.2.private"}
        assert (tmp_path / "job.2" / "checkpoint").exists()
        living.communicate(timeout=10)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_a_time_without_locks_and_a_lock_without_a_folder_go_too(tmp_path: Path) -> None:
    (tmp_path / "job.1").mkdir()
    (tmp_path / "job.2.lock").touch()
    remove_left_over(tmp_path)
    remove_left_over(tmp_path / "not" / "there" / "yet")
    assert list(tmp_path.iterdir()) == []


def test_clearing_never_touches_a_spool_in_use(tmp_path: Path) -> None:
    over = threading.Event()

    def clear() -> None:
        while not over.is_set():
            remove_left_over(tmp_path)

    clearer = threading.Thread(target=clear)
    clearer.start()
    try:
        for number in range(200):
            with spool(tmp_path / f"job.{number}") as folder:
                (folder / "checkpoint").touch()
                os.sched_yield()
                assert (folder / "checkpoint").exists()
    finally:
        over.set()
        clearer.join()
