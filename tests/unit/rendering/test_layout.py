import pytest

from core.errors import Rejected
from core.rendering.layout import Layout


@pytest.mark.parametrize(
    ("layout", "columns_and_rows", "pixels"),
    [
        (Layout(640, 480), (1, 1), (640, 480)),
        # Two cameras beside each other, the episodes below: 2 · 640 + 4; 4 · 480 + 3 · 4.
        (Layout(640, 480, 2, 4), (1, 4), (1284, 1932)),
        # In two columns three rows of 480 would be higher than 2 · 640.
        (Layout(640, 480, 1, 5), (3, 2), (1928, 964)),
        (Layout(640, 480, 1, 16), (4, 4), (2572, 1932)),
        # Two cameras are 1280 wide: two columns hold three rows.
        (Layout(640, 480, 2, 6), (2, 3), (2572, 1448)),
        # Nine pictures that are nine times as wide as high make a square.
        (Layout(900, 100, 1, 9), (1, 9), (900, 932)),
    ],
)
def test_up_to_four_episodes_stand_below_each_other_and_more_in_a_grid(
    layout: Layout, columns_and_rows: tuple[int, int], pixels: tuple[int, int]
) -> None:
    assert (layout.num_columns, layout.num_rows) == columns_and_rows
    assert (layout.whole_width, layout.whole_height) == pixels


@pytest.mark.parametrize("num_episodes", [1, 3, 5, 7, 64])
def test_no_two_pictures_overlap_and_none_reaches_beyond_the_whole(num_episodes: int) -> None:
    layout = Layout(64, 48, 2, num_episodes)
    places = [layout.place(episode, camera) for episode in range(num_episodes) for camera in range(2)]
    covered = {(row, column) for rows, columns in places for row in _of(rows) for column in _of(columns)}
    assert len(covered) == num_episodes * 2 * 64 * 48
    assert max(row for row, _ in covered) == layout.whole_height - 1
    assert max(column for _, column in covered) == layout.whole_width - 1


def test_a_video_that_would_be_too_large_is_refused_with_a_size_that_fits() -> None:
    # 3 · 1276 + 2 · 4 = 3836, and 1278 would make 3842.
    Layout(1276, 480, 3).check()
    with pytest.raises(
        Rejected, match="1 episode in pictures of 1278 × 480 pixels make a video of 3842 × 480"
    ) as wide:
        Layout(1278, 480, 3).check()
    assert "Pictures of 1276 × 480 would fit." in wide.value.detail
    assert [one.pointer for one in wide.value.problems] == ["/video/width", "/video/height", "/video/cameras"]
    # Four below each other: 4 · 958 + 12 = 3844; 956 is the next even height, in 4 : 3 with 1274.
    with pytest.raises(Rejected, match="would fit") as high:
        Layout(1278, 958, 1, 4).check()
    assert "a video of 1278 × 3844" in high.value.detail
    assert high.value.problems[-1].pointer == "/video/episodes"


@pytest.mark.parametrize(
    "layout", [Layout(3840, 2160, 16, 64), Layout(64, 3840, 1, 3), Layout(1920, 1080, 2, 5)]
)
def test_the_size_that_is_said_to_fit_does(layout: Layout) -> None:
    with pytest.raises(Rejected) as refusal:
        layout.check()
    width, height = map(int, refusal.value.detail.split("Pictures of ")[1].split(" would")[0].split(" × "))
    Layout(width, height, layout.num_cameras, layout.num_episodes).check()


def _of(pixels: slice) -> range:
    return range(pixels.start, pixels.stop)
