"""A device belongs to one process at a time, also to one whose supervisor has gone."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from worker.slot import SlotTaken, slot


def test_a_slot_in_use_is_not_given_out(tmp_path: Path) -> None:
    with (
        slot(tmp_path / "gpu-0.lock", 0),
        pytest.raises(SlotTaken, match="gpu-0"),
        slot(tmp_path / "gpu-0.lock", 0),
    ):
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
