"""Which camera a request means. The API asks here too, so nothing numerical is imported."""

from collections.abc import Sequence

from core.errors import Problem, Rejected

TRACK = "track"
POINTER = "/video/camera"


def camera_choices(cameras: Sequence[str]) -> list[str | int]:
    """`track`, and each of the model's as a job names it; by number where a name would not reach it."""
    return [TRACK, *(name if name and name != TRACK else number for number, name in enumerate(cameras))]


def check_camera(camera: str | int, cameras: Sequence[str]) -> None:
    """Raises Rejected unless `camera` is `track` or one of a model's, by name or by number."""
    model_camera(camera, cameras)


def model_camera(camera: str | int, cameras: Sequence[str]) -> int | None:
    """The number of the model's camera that is meant; None for `track`, which follows the body.

    cameras: the model's camera names in their order, empty for those without one. `track` always
    means this project's own camera; a model's camera of that name is reached by its number.
    Raises Rejected, naming those there are.
    """
    if camera == TRACK:
        return None
    if isinstance(camera, int):
        if 0 <= camera < len(cameras):
            return camera
    elif camera and camera in cameras:
        return cameras.index(camera)
    known = ", ".join([TRACK, *(name for name in cameras if name and name != TRACK)])
    numbers = f"; by number 0 to {len(cameras) - 1}" if cameras else ""
    detail = f"There is no camera {camera!r}; known are {known}{numbers}."
    raise Rejected(detail, [Problem(POINTER, detail)], cameras=[TRACK, *cameras])
