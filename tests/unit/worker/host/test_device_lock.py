"""A device belongs to one process at a time, also to one whose supervisor has gone."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from core.errors import Misconfigured
from core.retry import CalledOff
from worker.host.locks import SlotTaken, is_held, share_lock, slot, slot_names, slots, take_lock
from worker.stopping import Draining


def test_a_slot_in_use_is_not_given_out(tmp_path: Path) -> None:
    with (
        slot(tmp_path / "gpu-0.lock", 0),
        pytest.raises(SlotTaken, match="gpu-0"),
        slot(tmp_path / "gpu-0.lock", 0),
    ):
        pass


def test_a_lock_that_becomes_shared_holds_also_when_somebody_has_removed_its_file(tmp_path: Path) -> None:
    path = tmp_path / "gpu-0.lock"
    alone = take_lock(path)
    assert alone is not None
    path.unlink()  # By who looked at it between the two locks.
    shared = share_lock(path, alone)
    assert is_held(path)
    other = take_lock(path, shared=True)
    assert other is not None
    os.close(other)
    os.close(shared)
    assert not is_held(path)


def test_who_waits_for_a_slot_hears_that_it_is_called_off(tmp_path: Path) -> None:
    draining = Draining()
    with slot(tmp_path / "gpu-0.lock", 0):
        threading.Timer(0.1, draining.set).start()
        with pytest.raises(CalledOff), slot(tmp_path / "gpu-0.lock", float("inf"), draining.is_set):
            pass


def test_an_orphan_keeps_the_slot_until_it_ends(tmp_path: Path) -> None:
    path = tmp_path / "gpu-0.lock"
    with slot(path, 0) as descriptor:
        orphan = subprocess.Popen(
            [sys.executable, "-c", "input()"], stdin=subprocess.PIPE, pass_fds=(descriptor,)
        )
    with pytest.raises(SlotTaken), slot(path, 0):
        pass
    orphan.communicate(b"\n")
    with slot(path, 0) as descriptor:
        assert os.fstat(descriptor)


def test_locks_that_nobody_holds_do_not_pile_up(tmp_path: Path) -> None:
    (tmp_path / "cpu-of-a-worker-long-gone.lock").touch()
    with slot(tmp_path / "cpu-1.lock", 0):
        with slot(tmp_path / "cpu-2.lock", 0):
            pass
        assert [file.name for file in tmp_path.iterdir()] == ["cpu-1.lock"]
    assert list(tmp_path.iterdir()) == []


def test_removing_locks_never_gives_a_slot_to_two(tmp_path: Path) -> None:
    inside, most, turns = 0, 0, 200

    def take_turns() -> None:
        nonlocal inside, most
        for _ in range(turns):
            with slot(tmp_path / "gpu-0.lock", 60):
                inside += 1
                os.sched_yield()
                most = max(most, inside)
                inside -= 1

    threads = [threading.Thread(target=take_turns) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (inside, most) == (0, 1)


def test_a_job_on_two_gpus_waits_for_both_and_keeps_neither_if_one_stays_taken(tmp_path: Path) -> None:
    one, other = tmp_path / "gpu-0.lock", tmp_path / "gpu-1.lock"
    with slot(other, 0), pytest.raises(SlotTaken, match="gpu-1"), slots([one, other], 0.2):
        pass
    with slot(one, 0), slot(other, 0):
        pass


def test_an_orphan_keeps_all_its_slots_until_it_ends(tmp_path: Path) -> None:
    paths = [tmp_path / "gpu-0.lock", tmp_path / "gpu-1.lock"]
    with slots(paths, 0) as descriptors:
        orphan = subprocess.Popen(
            [sys.executable, "-c", "input()"], stdin=subprocess.PIPE, pass_fds=descriptors
        )
    for path in paths:
        with pytest.raises(SlotTaken, match=path.stem), slot(path, 0):
            pass
    orphan.communicate(b"\n")
    with slots(paths, 0) as descriptors:
        assert len(set(descriptors)) == 2
    assert list(tmp_path.iterdir()) == []


def test_two_that_want_the_same_slots_in_different_orders_never_wait_for_each_other(tmp_path: Path) -> None:
    first, second = tmp_path / "gpu-0.lock", tmp_path / "gpu-1.lock"
    done = list[int]()

    def take_turns(*paths: Path) -> None:
        for turn in range(100):
            with slots(paths, 60):
                os.sched_yield()
            done.append(turn)

    threads = [
        threading.Thread(target=take_turns, args=paths, daemon=True)
        for paths in ((first, second), (second, first))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert len(done) == 200


def test_a_gpu_is_called_by_the_hosts_number_in_every_container(tmp_path: Path) -> None:
    for dev, present in (("whole", ("nvidia0", "nvidia1")), ("second", ("nvidia1",))):
        for name in present:
            (tmp_path / dev / name).mkdir(parents=True)
    names = [slot_names(f"gpu:{index}", 1, tmp_path / "whole") for index in (0, 1)]
    assert names[0] != names[1]
    assert slot_names("gpu:0", 7, tmp_path / "second") == slot_names("gpu:1", 8, tmp_path / "whole")
    # Several GPUs are the slots of each.
    assert slot_names("gpu:0,1", 9, tmp_path / "whole") == (*names[0], *names[1])


def test_a_gpu_that_has_gone_is_refused_with_the_setting(tmp_path: Path) -> None:
    with pytest.raises(Misconfigured, match=r"^GAITWAY_DEVICE=gpu:0, but no NVIDIA GPU is visible here"):
        slot_names("gpu:0", 7, tmp_path)


def test_every_cpu_worker_has_a_slot_of_its_own_and_keeps_it() -> None:
    assert slot_names("cpu", 7) == slot_names("cpu", 7) != slot_names("cpu", 8)


def test_equal_process_ids_of_two_containers_are_two_slots() -> None:
    code = "from worker.host.locks import slot_names; print(slot_names('cpu', 7)[0])"
    contained = subprocess.run(
        ["unshare", "--pid", "--fork", "--mount-proc", sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
    )
    if "unshare" in contained.stderr:
        pytest.skip(f"no new process ids here: {contained.stderr.strip()}")
    assert contained.stdout.strip() != slot_names("cpu", 7)[0]
    assert (
        contained.stdout[:40] == slot_names("cpu", 7)[0][:40]
    )  # `cpu-` and the boot's id: the same machine.
