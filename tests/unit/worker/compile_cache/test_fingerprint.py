"""Which machines may use each other's programs."""

from pathlib import Path

import pytest

from core.adapters.s3.keys import is_portable
from core.storage import keys
from worker.compile_cache import fingerprint as module
from worker.compile_cache.fingerprint import fingerprint


def machine(folder: Path, flags: str = "fpu avx2", model: str = "NVIDIA H200") -> tuple[Path, Path]:
    """Its /dev, with GPU 3 of its host, and its /proc, where every GPU of the host shows."""
    dev, proc = folder / "dev", folder / "proc"
    dev.mkdir(parents=True)
    (dev / "nvidia3").touch()
    proc.mkdir()
    (proc / "cpuinfo").write_text(
        f"processor\t: 0\nflags\t\t: {flags}\n\nprocessor\t: 1\nflags\t\t: {flags}\n"
    )
    for number, name in (("0", "NVIDIA A2"), ("3", model)):
        gpu = proc / "driver" / "nvidia" / "gpus" / f"0000:0{number}:00.0"
        gpu.mkdir(parents=True)
        (gpu / "information").write_text(f"Model: \t\t {name}\nDevice Minor: \t {number}\n")
    return dev, proc


def test_machines_of_one_kind_are_one(tmp_path: Path) -> None:
    one, other = machine(tmp_path / "1"), machine(tmp_path / "2", flags="avx2 fpu")
    assert fingerprint("cpu", *one) == fingerprint("cpu", *other)
    assert fingerprint("gpu:0", *one) == fingerprint("gpu:0", *other)


def test_a_cpu_that_can_do_more_is_another(tmp_path: Path) -> None:
    one, other = machine(tmp_path / "1"), machine(tmp_path / "2", flags="fpu avx2 avx512f")
    assert fingerprint("cpu", *one) != fingerprint("cpu", *other)
    assert fingerprint("gpu:0", *one) == fingerprint("gpu:0", *other)


def test_another_gpu_is_another(tmp_path: Path) -> None:
    one, other = machine(tmp_path / "1"), machine(tmp_path / "2", model="NVIDIA A2")
    assert fingerprint("gpu:0", *one) != fingerprint("gpu:0", *other)
    assert fingerprint("cpu", *one) == fingerprint("cpu", *other)


def test_several_gpus_of_a_model_use_what_one_does(tmp_path: Path) -> None:
    alike, mixed = machine(tmp_path / "1", model="NVIDIA A2"), machine(tmp_path / "2")
    for dev, _ in (alike, mixed):
        (dev / "nvidia0").touch()
    assert fingerprint("gpu:0,1", *alike) == fingerprint("gpu:0", *alike)
    assert len({fingerprint(device, *mixed) for device in ("gpu:0", "gpu:1", "gpu:0,1")}) == 3


def test_another_version_is_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = machine(tmp_path / "1")
    before = fingerprint("cpu", *here)
    monkeypatch.setattr(module, "version", lambda package: "99" if package == "jaxlib" else "1")
    assert fingerprint("cpu", *here) != before


def test_a_machine_that_says_nothing_has_one_nevertheless(tmp_path: Path) -> None:
    assert fingerprint("cpu", tmp_path, tmp_path).startswith("cpu-")
    assert fingerprint("gpu:0", tmp_path, tmp_path).startswith("gpu-")


def test_every_store_keeps_its_name() -> None:
    assert is_portable(keys.cached(fingerprint("cpu"), "ant", "20261121T091500Z", "jax/jit_epoch-0a-cache"))
