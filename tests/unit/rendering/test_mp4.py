from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from core.rendering.mp4 import Mp4Writer, write_png


def picture(number: int, width: int = 64, height: int = 48) -> NDArray[np.uint8]:
    """A bright bar that moves a pixel a frame."""
    frame = np.zeros((height, width, 3), np.uint8)
    frame[:, number % width] = 255
    return frame


def write(path: Path, num_frames: int) -> None:
    with Mp4Writer(path, width=64, height=48, fps=10) as video:
        for number in range(num_frames):
            video.write(picture(number))


def test_a_video_is_h264_that_browsers_play_with_all_its_frames(tmp_path: Path) -> None:
    write(tmp_path / "v.mp4", 25)
    with av.open(str(tmp_path / "v.mp4")) as video:
        stream = video.streams.video[0]
        frames = list(video.decode(stream))
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert (stream.width, stream.height) == (64, 48)
        assert stream.average_rate == 10
        assert float(stream.duration * stream.time_base) == pytest.approx(2.5)
    assert [frame.pts for frame in frames] == [frame * frames[1].pts for frame in range(25)]
    # A key frame at least once a second, so that a player can jump.
    keys = [number for number, frame in enumerate(frames) if frame.key_frame]
    assert keys[0] == 0
    assert np.diff([*keys, 25]).max() <= 10


def test_a_video_plays_while_it_loads(tmp_path: Path) -> None:
    write(tmp_path / "v.mp4", 5)
    content = (tmp_path / "v.mp4").read_bytes()
    assert 0 < content.index(b"moov") < content.index(b"mdat")


def test_equal_frames_give_equal_bytes(tmp_path: Path) -> None:
    write(tmp_path / "a.mp4", 15)
    write(tmp_path / "b.mp4", 15)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_a_video_that_fails_half_way_leaves_nothing(tmp_path: Path) -> None:
    with (
        pytest.raises(ValueError, match="array"),
        Mp4Writer(tmp_path / "v.mp4", width=64, height=48, fps=10) as video,
    ):
        video.write(np.zeros((48, 64), np.uint8))
    assert list(tmp_path.iterdir()) == []


def test_a_poster_keeps_every_pixel(tmp_path: Path) -> None:
    frame = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    write_png(tmp_path / "p.png", frame)
    with av.open(str(tmp_path / "p.png")) as image:
        [back] = image.decode(video=0)
    np.testing.assert_array_equal(back.to_ndarray(format="rgb24"), frame)
    assert [path.name for path in tmp_path.iterdir()] == ["p.png"]
