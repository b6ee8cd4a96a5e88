"""How much memory a worker says that its device has; and a run that has not even got the least."""

import os
from pathlib import Path

import pytest

from core.algorithms.memory import MemoryNeed, MemoryPart
from core.errors import JobFailed
from core.reasons import Reason
from worker.host.device import device_memory
from worker.host.memory import allowed_bytes
from worker.training.train import check_memory


def test_a_cpu_has_what_a_training_may_take_of_the_machine() -> None:
    assert device_memory("cpu", None) == allowed_bytes(None)
    assert device_memory("cpu", 2**30) == 2**30


@pytest.mark.parametrize(
    ("said", "expected"),
    [("81559\n", 81559 * 2**20), ("81559\n40960\n", 40960 * 2**20), ("[N/A]\n", None), ("", None)],
)
def test_gpus_have_what_the_smallest_of_them_has(
    said: str, expected: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "nvidia-smi"
    program.write_text(f'#!/bin/sh\n[ "$3" = --id=0,1 ] || exit 1\nprintf "{said}"\n'.replace('\n"', '\\n"'))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    assert device_memory("gpu:0,1", None) == expected


def test_without_the_driver_s_program_nothing_is_known(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert device_memory("gpu:0", None) is None


def test_a_run_that_cannot_fit_ends_before_it_is_made() -> None:
    check_memory(MemoryNeed((MemoryPart("tables", 2**20, ("agents",)),)), "cpu")
    with pytest.raises(
        JobFailed, match=r"at least 1 PiB .* this worker's CPU has .* lower agents\."
    ) as failed:
        check_memory(MemoryNeed((MemoryPart("tables", 2**50, ("agents",)),)), "cpu")
    assert failed.value.reason == Reason.OUT_OF_MEMORY
