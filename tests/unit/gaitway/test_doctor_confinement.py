"""The doctor's check of users' models, on this machine and on one that lacks parts of the confinement."""

from pathlib import Path

import pytest

from gaitway.service.doctor import machine
from worker.confinement import landlock

_BEFORE = "from worker.confinement import landlock, privileges, seccomp\n"


def without(monkeypatch: pytest.MonkeyPatch, *changes: str) -> None:
    """The probe's process finds itself on a system that lacks something."""
    lines = _BEFORE + "".join(f"{change}\n" for change in changes)
    monkeypatch.setattr(machine, "_PROBE", lines + machine._PROBE)  # pyright: ignore[reportPrivateUsage]


@pytest.mark.skipif(not landlock.version(), reason="this kernel has no Landlock")
def test_this_machine_confines_the_reader_of_a_model_and_leaves_nothing(tmp_path: Path) -> None:
    check = machine.confinement(tmp_path)
    assert check.state == "pass"
    assert f"(Landlock {landlock.version()})" in check.detail
    assert "files, calls" in check.detail
    assert list(tmp_path.iterdir()) == []


def test_a_system_that_can_confine_nothing_is_told_with_the_way_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without(monkeypatch, "landlock.version = lambda: 0", "privileges.become_nobody = lambda folder: False")
    check = machine.confinement(tmp_path)
    assert (check.state, "refused here" in check.detail) == ("warn", True)
    assert "/sys/kernel/security/lsm" in check.remedy
    assert "GAITWAY_MODELS=unconfined" in check.remedy


def test_a_worker_of_another_user_without_landlock_is_told_who_is_not_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without(monkeypatch, "landlock.version = lambda: 0", "privileges.become_nobody = lambda folder: True")
    check = machine.confinement(tmp_path)
    assert check.state == "warn"
    assert "previews and trainings may read the worker's files" in check.detail


def test_a_processor_whose_calls_are_not_known_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without(monkeypatch, "seccomp._PROCESSORS.clear()")
    check = machine.confinement(tmp_path / "not there")
    assert (check.state, "calls: " in check.detail) == ("warn", True)
