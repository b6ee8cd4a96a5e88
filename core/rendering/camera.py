"""The cameras that a request means. The API uses this too, so nothing numerical is imported."""

from collections.abc import Sequence

from core.errors import Problem, Rejected

TRACK = "track"


def camera_choices(cameras: Sequence[str]) -> list[str | int]:
    """`track` and the model's cameras, by name, or by number where the name would not reach it."""
    return [TRACK, *(name if name and name != TRACK else number for number, name in enumerate(cameras))]


def check_cameras(
    asked: Sequence[str | int], cameras: Sequence[str], pointer: str = "/video/cameras"
) -> None:
    """Raises Rejected unless each is `track` or a camera of the model, by name or number, and none repeats.

    pointer: the field of the job that lists them; the index of the wrong one is appended.
    """
    seen: dict[int | None, str | int] = {}
    for place, camera in enumerate(asked):
        at = f"{pointer}/{place}"
        number = model_camera(camera, cameras, at)
        if number in seen:
            same = "" if seen[number] == camera else f" as {seen[number]!r}"
            detail = f"The camera {camera!r} is already listed{same}; each is shown once."
            raise Rejected(detail, [Problem(at, detail)])
        seen[number] = camera


def model_camera(camera: str | int, cameras: Sequence[str], pointer: str = "/video/camera") -> int | None:
    """The number of the model's camera that `camera` means; None for `track`, which follows the body.

    cameras: the model's camera names in their order, empty for a camera without one. `track` always
    means this project's own camera; a model's camera of that name is reached by its number.
    Raises Rejected, naming the known cameras.
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
    raise Rejected(detail, [Problem(pointer, detail)], cameras=[TRACK, *cameras])
