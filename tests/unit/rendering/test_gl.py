import pytest

from core.rendering.gl import RenderingFailed, backends, last_line, probe


def names(environ: dict[str, str], platform: str = "linux") -> list[tuple[str, str | None]]:
    found = backends(environ, platform)
    return [(backend.name, backend.environ.get("MUJOCO_EGL_DEVICE_ID")) for backend in found]


def test_egl_comes_before_osmesa() -> None:
    assert names({}) == [("egl", None), ("osmesa", None)]


def test_a_back_end_that_somebody_chose_is_the_only_one() -> None:
    assert names({"MUJOCO_GL": "OSMesa", "CUDA_VISIBLE_DEVICES": "1"}) == [("osmesa", None)]


def test_a_job_draws_on_the_gpu_it_may_use_if_egl_has_it() -> None:
    assert names({"CUDA_VISIBLE_DEVICES": "3,4"}) == [("egl", "3"), ("egl", None), ("osmesa", None)]


@pytest.mark.parametrize("devices", ["", "-1", "GPU-8f3c", "MIG-1"])
def test_what_is_no_number_of_a_gpu_leaves_the_choice_to_egl(devices: str) -> None:
    assert names({"CUDA_VISIBLE_DEVICES": devices}) == [("egl", None), ("osmesa", None)]


def test_a_chosen_egl_device_stays_chosen() -> None:
    environ = {"CUDA_VISIBLE_DEVICES": "3", "MUJOCO_EGL_DEVICE_ID": "0"}
    assert names(environ) == [("egl", None), ("osmesa", None)]


def test_macos_has_its_own() -> None:
    assert names({}, "darwin") == [("cgl", None)]


def test_no_back_end_at_all_is_told_with_the_packages_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "no-such-thing")
    with pytest.raises(RenderingFailed, match="libegl1, libgl1-mesa-dri and libopengl0") as failure:
        probe()
    assert failure.value.reason == "no_gl"
    assert "no-such-thing" in failure.value.detail


def test_the_last_line_that_says_anything() -> None:
    assert last_line("a\n b \n\n") == "b"
    assert last_line("\n") == ""
