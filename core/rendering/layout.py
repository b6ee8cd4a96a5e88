"""The cameras that a request means, and where each picture of a video stands; imports no numerical code."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

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


# The gap between two pictures; even, as widths and heights are.
GAP_PIXELS = 4
# The widest and highest H.264 that players can be expected to accept.
MOST_PIXELS = 3840
# Up to so many episodes stand one below the other; more in a grid.
_ONE_COLUMN = 4
_SMALLEST_PIXELS = 16


@dataclass(frozen=True)
class Layout:
    """A video's pictures: of each episode those of all cameras side by side, the episodes below each other.

    More than four episodes are in the fewest columns that make the whole no taller than it is wide, row by
    row. width, height: pixels of each picture.
    """

    width: int
    height: int
    num_cameras: int = 1
    num_episodes: int = 1

    @property
    def num_columns(self) -> int:
        """How many episodes are beside each other."""
        if self.num_episodes <= _ONE_COLUMN:
            return 1
        return next(number for number in range(1, self.num_episodes + 1) if self._is_wide_enough(number))

    @property
    def num_rows(self) -> int:
        return -(-self.num_episodes // self.num_columns)

    @property
    def whole_width(self) -> int:
        """Pixels, with the gaps."""
        return _extent(self.width, self.num_columns * self.num_cameras)

    @property
    def whole_height(self) -> int:
        """Pixels, with the gaps."""
        return _extent(self.height, self.num_rows)

    def place(self, episode: int, camera: int) -> tuple[slice, slice]:
        """The rows and columns of pixels of this episode as this camera sees it."""
        row, column = divmod(episode, self.num_columns)
        top = row * (self.height + GAP_PIXELS)
        left = (column * self.num_cameras + camera) * (self.width + GAP_PIXELS)
        return slice(top, top + self.height), slice(left, left + self.width)

    def check(self) -> None:
        """Raises Rejected if the whole is too large for a video, with a size of the pictures that fits."""
        if self._fits():
            return
        width, height = next(self._smaller(), (_SMALLEST_PIXELS, _SMALLEST_PIXELS))
        detail = (
            f"{_counted(self.num_cameras, 'camera')} and {_counted(self.num_episodes, 'episode')} in "
            f"pictures of {self.width} × {self.height} pixels make a video of {self.whole_width} × "
            f"{self.whole_height}; it may have {MOST_PIXELS} × {MOST_PIXELS}. Pictures of {width} × {height} "
            "would fit."
        )
        several = {"cameras": self.num_cameras > 1, "episodes": self.num_episodes > 1}
        fields = ["width", "height", *(field for field, is_so in several.items() if is_so)]
        raise Rejected(detail, [Problem(f"/video/{field}", detail) for field in fields])

    def _is_wide_enough(self, num_columns: int) -> bool:
        num_rows = -(-self.num_episodes // num_columns)
        return num_rows * self.height <= num_columns * self.num_cameras * self.width

    def _fits(self) -> bool:
        return max(self.whole_width, self.whole_height) <= MOST_PIXELS

    def _smaller(self) -> Iterator[tuple[int, int]]:
        """Sizes that fit, of the same proportions, the largest first."""
        for width in range(self.width - 2, _SMALLEST_PIXELS, -2):
            height = max(_SMALLEST_PIXELS, 2 * round(self.height * width / self.width / 2))
            if Layout(width, height, self.num_cameras, self.num_episodes)._fits():
                yield width, height


def _extent(pixels: int, number: int) -> int:
    return number * pixels + (number - 1) * GAP_PIXELS


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
