"""Which device a worker serves, on machines and in containers that are made of files here."""

from pathlib import Path

import pytest

from core.errors import Misconfigured
from worker.host.device import device_of, visible_gpus


@pytest.fixture
def dev(tmp_path: Path) -> Path:
    """A /dev without a GPU, but with what else the driver puts there."""
    folder = tmp_path / "dev"
    folder.mkdir()
    for name in ("null", "nvidiactl", "nvidia-uvm", "nvidia-modeset"):
        (folder / name).touch()
    (folder / "nvidia-caps").mkdir()
    return folder


def add(dev: Path, *names: str) -> None:
    for name in names:
        (dev / name).touch()


@pytest.mark.parametrize(
    ("present", "wanted", "device"),
    [
        ([], "auto", "cpu"),
        ([], "cpu", "cpu"),
        (["nvidia0", "nvidia1"], "auto", "gpu:0"),
        (["nvidia0", "nvidia1"], "gpu", "gpu:0"),
        (["nvidia0", "nvidia1"], "gpu:1", "gpu:1"),
        (["nvidia0"], "cpu", "cpu"),
        # A container that was given the host's third GPU alone counts from 0.
        (["nvidia2"], "gpu", "gpu:0"),
        (["dxg"], "gpu", "gpu:0"),
        (["nvidia0", "nvidia1"], "gpu:0,1", "gpu:0,1"),
        (["nvidia0", "nvidia1"], "gpu:1,0", "gpu:0,1"),
        (["nvidia0", "nvidia1", "nvidia2", "nvidia3"], "gpu:0-1,3", "gpu:0,1,3"),
    ],
)
def test_a_worker_serves_what_it_is_told_or_what_it_finds(
    dev: Path, present: list[str], wanted: str, device: str
) -> None:
    add(dev, *present)
    assert device_of(wanted, dev, has_cuda=True) == device


def test_a_gpu_that_jax_cannot_use_is_left_alone_unless_it_is_asked_for(dev: Path) -> None:
    add(dev, "nvidia0")
    assert device_of("auto", dev, has_cuda=False) == "cpu"
    assert device_of("gpu", dev, has_cuda=False) == "gpu:0"


@pytest.mark.parametrize(
    ("present", "wanted", "seen"),
    [
        ([], "gpu", "GAITWAY_DEVICE=gpu, but no NVIDIA GPU is visible here"),
        ([], "gpu:0", "GAITWAY_DEVICE=gpu:0, but no NVIDIA GPU is visible here"),
        (["nvidia0"], "gpu:1", "GAITWAY_DEVICE=gpu:1, but only 1 is visible here"),
        (["nvidia0", "nvidia1"], "gpu:2", "GAITWAY_DEVICE=gpu:2, but only 2 are visible here"),
        (["dxg"], "gpu:1", "GAITWAY_DEVICE=gpu:1, but only 1 is visible here"),
        (["nvidia0", "nvidia1"], "gpu:0,2", "GAITWAY_DEVICE=gpu:0,2, but only 2 are visible here"),
        (["nvidia0", "nvidia1"], "gpu:0-7", "GAITWAY_DEVICE=gpu:0-7, but only 2 are visible here"),
    ],
)
def test_a_gpu_that_is_not_there_is_refused_with_the_setting_and_the_remedy(
    dev: Path, present: list[str], wanted: str, seen: str
) -> None:
    add(dev, *present)
    with pytest.raises(Misconfigured) as refusal:
        device_of(wanted, dev)
    assert refusal.value.detail.startswith(seen)
    for remedy in ("NVIDIA Container Toolkit", "--profile gpu", "GAITWAY_DEVICE=cpu"):
        assert remedy in refusal.value.detail


@pytest.mark.parametrize(
    ("wanted", "why"), [("gpu:0,0", "a GPU twice"), ("gpu:0-1,1", "a GPU twice"), ("gpu:1-0", "no GPU")]
)
def test_gpus_that_cannot_be_told_apart_are_refused(dev: Path, wanted: str, why: str) -> None:
    add(dev, "nvidia0", "nvidia1")
    with pytest.raises(Misconfigured, match=f"GAITWAY_DEVICE={wanted} names {why}. Write gpu:0,1"):
        device_of(wanted, dev)


def test_gpus_are_in_the_order_of_their_numbers(dev: Path) -> None:
    add(dev, *(f"nvidia{number}" for number in (10, 9, 0)))
    assert visible_gpus(dev) == ["nvidia0", "nvidia9", "nvidia10"]
