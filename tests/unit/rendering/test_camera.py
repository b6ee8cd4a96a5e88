import subprocess
import sys

import pytest

from core.errors import Rejected
from core.rendering.layout import check_cameras, model_camera

CAMERAS = ["side", "", "track"]


@pytest.mark.parametrize(("camera", "number"), [("track", None), ("side", 0), (0, 0), (1, 1), (2, 2)])
def test_a_camera_is_found_by_name_or_number_and_track_is_always_ours(
    camera: str | int, number: int | None
) -> None:
    assert model_camera(camera, CAMERAS) == number


@pytest.mark.parametrize("camera", ["front", "", 3, -1, "0"])
def test_an_unknown_camera_is_refused_with_the_known_ones(camera: str | int) -> None:
    with pytest.raises(Rejected, match="known are track, side; by number 0 to 2") as refusal:
        model_camera(camera, CAMERAS)
    assert [problem.pointer for problem in refusal.value.problems] == ["/video/camera"]


def test_a_model_without_cameras_has_track_alone() -> None:
    assert model_camera("track", []) is None
    with pytest.raises(Rejected, match=r"known are track\."):
        model_camera(0, [])


@pytest.mark.parametrize(
    ("asked", "pointer", "said"),
    [
        (["track", "side", "front"], "/video/cameras/2", "no camera 'front'"),
        (["track", "track"], "/video/cameras/1", r"'track' is already listed;"),
        (["side", "track", 0], "/video/cameras/2", "0 is already listed as 'side'"),
    ],
)
def test_of_several_cameras_the_one_at_fault_is_named(
    asked: list[str | int], pointer: str, said: str
) -> None:
    check_cameras(["track", "side", 1, 2], CAMERAS)
    with pytest.raises(Rejected, match=said) as refusal:
        check_cameras(asked, CAMERAS)
    assert [problem.pointer for problem in refusal.value.problems] == [pointer]


def test_the_api_can_check_a_camera_without_the_numerical_stack() -> None:
    code = (
        "import sys, core.rendering.layout, core.rendering.layout, core.rendering.request;"
        "sys.exit(any(name in sys.modules for name in ('mujoco', 'numpy', 'jax', 'av')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
