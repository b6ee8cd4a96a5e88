"""Where a worker keeps the kernels that Warp compiles."""

from pathlib import Path

import pytest

from core.errors import JobFailed
from core.physics import availability
from core.physics.choose import set_warp_cache


def test_a_worker_without_the_extra_ends_the_job_with_the_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(availability, "find_spec", lambda name: None)
    with pytest.raises(JobFailed, match="uv sync --inexact --extra warp") as failure:
        set_warp_cache(Path("kernels"))
    assert failure.value.reason == "no_device"


def test_kernels_are_kept_where_they_are_told_or_where_the_environment_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    warp = pytest.importorskip("warp")
    monkeypatch.setattr(warp.config, "kernel_cache_dir", None)
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path / "elsewhere"))
    set_warp_cache(tmp_path / "here")
    assert warp.config.kernel_cache_dir is None  # Warp reads the variable itself
    monkeypatch.delenv("WARP_CACHE_PATH")
    set_warp_cache(tmp_path / "here")
    assert warp.config.kernel_cache_dir == str(tmp_path / "here")
