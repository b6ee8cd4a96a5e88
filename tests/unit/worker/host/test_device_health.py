"""Whether a worker may take jobs; shell commands stand for the test of a GPU."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from worker.host.device_health import (
    EACH_WORKS,
    DeviceHealth,
    DeviceTest,
    SeatHealth,
    command_for,
    mark_of,
    result_of,
    set_aside,
)
from worker.host.locks import SlotTaken, slot

# Passed as soon as the file is there.
_PASSES_WITH = "test -e {} || {{ echo 'Traceback'; echo 'cuda:0 multiplies wrongly.'; echo; exit 3; }}"


@pytest.fixture
def works(tmp_path: Path) -> Path:
    """The device works while this file is there."""
    file = tmp_path / "works"
    file.touch()
    return file


@pytest.fixture
def health(tmp_path: Path, works: Path) -> DeviceHealth:
    command = ("/bin/sh", "-c", _PASSES_WITH.format(works))
    return DeviceHealth("gpu:0", tmp_path, ("gpu-nvidia0",), command, pauses_s=(0.05, 1000))


def run(script: str, tmp_path: Path, limit_s: float = 10) -> DeviceTest:
    return DeviceTest(("/bin/sh", "-c", script), "gpu:0", tmp_path, limit_s=limit_s)


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_a_cpu_is_ready_at_once(tmp_path: Path) -> None:
    health = DeviceHealth("cpu", tmp_path, ("cpu",), command_for("cpu"))
    assert health.is_fit()
    assert health.state == "ready"


def test_each_gpu_of_a_worker_is_tested() -> None:
    command = command_for("gpu:1,3")
    assert command is not None
    assert command[1:] == ("-m", "worker.training.device_test", "2")


@pytest.mark.parametrize(
    ("script", "problem"),
    [
        ("true", None),
        ("echo cuda:0 multiplies wrongly.; echo; exit 3", "failed (status 3): cuda:0 multiplies wrongly."),
        ("exit 1", "failed (status 1): it said nothing."),
        ("kill -SEGV $$", "was ended by SIGSEGV: it said nothing."),
    ],
)
def test_a_test_says_what_it_saw(script: str, problem: str | None, tmp_path: Path) -> None:
    told = result_of(run(script, tmp_path), lambda: False)
    assert told == (problem and f"A test of the device gpu:0 {problem}")


def test_cards_that_fail_only_together_are_known(tmp_path: Path) -> None:
    for script, each_works in (("exit 1", False), (f"echo '{EACH_WORKS}'; sleep 1000", True)):
        test = run(script, tmp_path, limit_s=0.5)
        assert result_of(test, lambda: False) is not None
        assert test.each_works == each_works


def test_numbers_are_added_up_over_several_cards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    monkeypatch.setenv("XLA_FLAGS", "--xla_force_host_platform_device_count=2")
    added = "import jax; from worker.training.device_test import test_together; test_together(jax.devices())"
    subprocess.run([sys.executable, "-c", added], check=True, timeout=60)


def test_a_device_that_hangs_fails_its_test(tmp_path: Path) -> None:
    told = result_of(run("sleep 1000", tmp_path, limit_s=0.1), lambda: False)
    assert told == "A test of the device gpu:0 did not end within 0.1 s."


def test_a_test_that_is_called_off_says_nothing_and_leaves_nobody(tmp_path: Path) -> None:
    test = run("sleep 1000", tmp_path)
    assert result_of(test, lambda: True) is None
    assert test.is_over()


def test_a_gpu_that_jax_does_not_find_fails_the_test(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    command = command_for("gpu:0")
    assert command is not None
    told = result_of(DeviceTest(command, "gpu:0", tmp_path), lambda: False)
    assert told is not None
    assert "failed (status 1): JAX finds only cpu:0." in told


@pytest.mark.gpu
def test_a_gpu_that_works_passes(tmp_path: Path) -> None:
    command = command_for("gpu:0")
    assert command is not None
    assert result_of(DeviceTest(command, "gpu:0", tmp_path), lambda: False) is None


def test_a_worker_is_ready_when_its_device_has_passed(health: DeviceHealth) -> None:
    assert health.state == "testing"
    assert not health.is_fit()
    until(health.is_fit)
    assert (health.state, health.problem) == ("ready", None)


def test_a_device_that_fails_is_set_aside_and_tried_again(health: DeviceHealth, works: Path) -> None:
    works.unlink()
    until(lambda: health.is_fit() or health.state == "device_failed")
    assert health.problem == "A test of the device gpu:0 failed (status 3): cuda:0 multiplies wrongly."
    assert not health.is_fit()
    works.touch()
    until(health.is_fit)
    assert (health.state, health.problem) == ("ready", None)


def test_an_attempt_has_the_device_set_aside_until_it_passes(health: DeviceHealth, tmp_path: Path) -> None:
    until(health.is_fit)
    set_aside(tmp_path, ["gpu-nvidia0"], "It crashed.")
    assert not health.is_fit()
    assert (health.state, health.problem) == ("device_failed", "It crashed.")
    until(health.is_fit)
    assert not mark_of(tmp_path, "gpu-nvidia0").exists()


def test_a_further_seat_of_a_gpu_waits_for_the_test_of_the_first(
    health: DeviceHealth, tmp_path: Path
) -> None:
    seat = SeatHealth(tmp_path, "gpu-nvidia0")
    assert not seat.is_fit()
    assert seat.state == "testing"
    until(health.is_fit)
    assert seat.is_fit()
    set_aside(tmp_path, ["gpu-nvidia0"], "It crashed.")
    assert not seat.is_fit()
    assert (seat.state, seat.problem) == ("device_failed", "It crashed.")
    assert not health.is_fit()
    until(health.is_fit)
    assert seat.is_fit()
    DeviceHealth("gpu:0", tmp_path, ("gpu-nvidia0",), ("true",))  # The worker has started again.
    assert not seat.is_fit()
    assert seat.state == "testing"


def test_nobody_else_uses_the_device_meanwhile(tmp_path: Path) -> None:
    waits = ("/bin/sh", "-c", f"until test -e {tmp_path}/go; do sleep 0.01; done")
    health = DeviceHealth("gpu:0", tmp_path, ("gpu-nvidia0",), waits)
    lock = tmp_path / "locks" / "gpu-nvidia0.lock"
    with slot(lock, 0):  # Somebody's training is still on its way out.
        assert not health.is_fit()
        assert health.state == "testing"
    assert not health.is_fit()
    with pytest.raises(SlotTaken), slot(lock, 0):
        pass
    (tmp_path / "go").touch()
    until(health.is_fit)
    with slot(lock, 0):
        pass


@pytest.mark.parametrize("device", ["cpu", "gpu:0"])
def test_a_device_that_another_process_holds_is_set_aside_until_that_has_ended(
    device: str, tmp_path: Path
) -> None:
    """M7: a CPU, which is not tested, too."""
    command = None if device == "cpu" else ("/bin/sh", "-c", "true")
    health = DeviceHealth(device, tmp_path, ("held",), command, pauses_s=(0.05,))
    until(health.is_fit)
    with slot(tmp_path / "locks" / "held.lock", 0.0):
        set_aside(tmp_path, ["held"], "Another process still uses the device.")
        assert not health.is_fit()
        assert (health.state, health.problem) == ("device_failed", "Another process still uses the device.")
        time.sleep(0.1)
        assert not health.is_fit()
    until(health.is_fit)
    assert (health.state, health.problem) == ("ready", None)
    assert health.is_fit()
