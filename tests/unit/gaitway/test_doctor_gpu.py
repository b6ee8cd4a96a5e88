"""What the doctor says of a GPU that is wanted, or there, and not used."""

import json

import pytest

from core.settings import WorkerSettings
from gaitway.service.doctor import machine


@pytest.fixture
def jax_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    found = {"version": "1", "platform": "cpu", "devices": ["cpu"]}
    monkeypatch.setattr(machine, "probe", lambda *_, **__: json.dumps(found))
    return monkeypatch


@pytest.mark.parametrize(
    ("device", "has_gpu", "state"),
    [
        (None, False, "pass"),
        ("gpu", False, "pass"),  # The check of the device fails.
        ("gpu", True, "fail"),
        ("auto", True, "warn"),
        (None, True, "warn"),
        ("cpu", True, "pass"),
    ],
)
def test_jax_has_to_compute_on_the_gpu_that_a_worker_would_serve(
    device: str | None, has_gpu: bool, state: str, jax_on_the_cpu: pytest.MonkeyPatch
) -> None:
    jax_on_the_cpu.setattr(machine, "has_gpu", lambda: has_gpu)
    if device is None:
        jax_on_the_cpu.delenv("GAITWAY_DEVICE", raising=False)
    else:
        jax_on_the_cpu.setenv("GAITWAY_DEVICE", device)
    check = machine.jax_devices()
    assert check.state == state
    assert ("GAITWAY_DEVICE=cpu" in check.remedy) == (state != "pass")


def test_a_wanted_gpu_that_is_not_there_fails_with_the_worker_s_sentence(
    settings: WorkerSettings,
) -> None:
    check = machine.device(settings.model_copy(update={"device": "gpu:99"}))
    assert check.state == "fail"
    assert check.detail.startswith("GAITWAY_DEVICE=gpu:99, but")


@pytest.mark.parametrize("device", ["gpu:99", "gpu:98,99"])
def test_it_does_also_where_the_worker_s_other_settings_are_missing(
    device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAITWAY_DEVICE", device)
    check = machine.device(None)
    assert check.state == "fail"
    assert "NVIDIA Container Toolkit" in check.detail


@pytest.mark.parametrize("device", ["", "cpu", "auto", "gpu:first"])
def test_without_a_worker_s_settings_nothing_else_is_looked_at(
    device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAITWAY_DEVICE", device)
    assert machine.device(None).state == "skip"
