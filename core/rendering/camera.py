"""Which cameras a request means. The API asks here too, so nothing numerical is imported."""

from collections.abc import Sequence

from core.errors import Problem, Rejected

TRACK = "track"
# What is between two pictures side by side; even, as widths are.
GAP_PIXELS = 4
# What players of H.264 may be counted on to take.
WIDEST_PIXELS = 3840


def camera_choices(cameras: Sequence[str]) -> list[str | int]:
    """`track`, and each of the model's as a job names it; by number where a name would not reach it."""
    return [TRACK, *(name if name and name != TRACK else number for number, name in enumerate(cameras))]


def check_cameras(
    asked: Sequence[str | int], cameras: Sequence[str], pointer: str = "/video/cameras"
) -> None:
    """Raises Rejected unless each is `track` or one of a model's, by name or number, and none comes twice.

    pointer: where they stand in the job; the number of the one at fault is added to it.
    """
    seen: dict[int | None, str | int] = {}
    for place, camera in enumerate(asked):
        at = f"{pointer}/{place}"
        number = model_camera(camera, cameras, at)
        if number in seen:
            same = "" if seen[number] == camera else f" as {seen[number]!r}"
            detail = f"The camera {camera!r} is there before{same}; each is shown once."
            raise Rejected(detail, [Problem(at, detail)])
        seen[number] = camera


def check_width(width: int, num_cameras: int) -> None:
    """Raises Rejected where pictures of this width, side by side, make too wide a video."""
    whole = width_of(width, num_cameras)
    if whole > WIDEST_PIXELS:
        fits = (WIDEST_PIXELS + GAP_PIXELS) // num_cameras - GAP_PIXELS
        detail = (
            f"{num_cameras} cameras of {width} pixels each make a video {whole} pixels wide; it may have "
            f"{WIDEST_PIXELS}. A width of {fits - fits % 2} would fit."
        )
        raise Rejected(detail, [Problem("/video/width", detail), Problem("/video/cameras", detail)])


def width_of(width: int, num_cameras: int) -> int:
    """Pixels of a video of so many cameras, each `width` wide."""
    return num_cameras * width + (num_cameras - 1) * GAP_PIXELS


def model_camera(camera: str | int, cameras: Sequence[str], pointer: str = "/video/camera") -> int | None:
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
    raise Rejected(detail, [Problem(pointer, detail)], cameras=[TRACK, *cameras])
