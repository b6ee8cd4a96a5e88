"""The render process as the training process sees it: real GL, real encoder."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from core.rendering.gl import RenderingFailed, probe
from core.rendering.request import RenderRequest, RenderResult
from tests.extra import extra
from tests.unit.rendering.conftest import ball_request, rolling_ball
from worker.render.client import render

pytestmark = pytest.mark.usefixtures("gl")


def decoded(path: Path) -> list[NDArray[np.uint8]]:
    with av.open(str(path)) as video:
        return [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]


def red(frame: NDArray[np.uint8]) -> NDArray[np.intp]:
    """Rows and columns [N, 2] where the ball is."""
    channels = frame.astype(int)
    return np.argwhere((channels[..., 0] > 100) & (channels[..., 1] < 60) & (channels[..., 2] < 60))


@dataclass(frozen=True)
class Film:
    result: RenderResult
    poster: NDArray[np.uint8]
    frames: list[NDArray[np.uint8]]


@pytest.fixture(scope="module")
def films(gl: None, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Film]:
    """Three seconds of the ball as each camera sees it, and as both do."""
    made: dict[str, Film] = {}
    for name, cameras in (("track", ["track"]), ("fixed", ["fixed"]), ("both", ["track", "fixed"])):
        folder = tmp_path_factory.mktemp(name)
        result = render(ball_request(folder, rolling_ball(3.0), cameras=cameras), timeout_s=60.0)
        [poster] = decoded(folder / "poster.png")
        made[name] = Film(result, poster, decoded(folder / "video.mp4"))
    return made


def test_the_camera_follows_the_body_over_a_floor_that_passes_by(films: dict[str, Film]) -> None:
    result, frames = films["track"].result, films["track"].frames
    assert (result.frames, len(frames), result.seconds, result.codec) == (30, 30, 3.0, "h264")
    assert result.gl_renderer
    assert result.gl_backend in ("egl", "osmesa", "cgl")
    for frame in frames:
        # Nine metres on, the ball is still whole and within the middle half of the picture.
        rows, columns = red(frame).T
        assert 30 < rows.mean() < 90
        assert 40 < columns.mean() < 120
    assert np.abs(frames[0].astype(int) - frames[7]).mean() > 5


def test_a_body_that_runs_past_the_models_floor_still_has_one(films: dict[str, Film], tmp_path: Path) -> None:
    """Twice from the middle of 80 m to 20 m beyond their end; the second begins where the first did."""
    episodes = [rolling_ball(1.0, speed=60.0) for _ in range(2)]
    render(ball_request(tmp_path, *episodes), timeout_s=60.0)
    tiles = [frame[-10:].mean(axis=(0, 1)) for frame in films["track"].frames]
    below = [frame[-10:].mean(axis=(0, 1)) for frame in decoded(tmp_path / "video.mp4")]
    assert len(below) == 20
    assert (np.min(below, axis=0) > np.min(tiles, axis=0) - 10).all()
    assert (np.max(below, axis=0) < np.max(tiles, axis=0) + 10).all()


def test_the_poster_is_the_moment_in_the_middle(films: dict[str, Film]) -> None:
    film = films["track"]
    differences = [np.abs(film.poster.astype(int) - frame).mean() for frame in film.frames]
    assert int(np.argmin(differences)) == 15


def test_a_stock_grey_stage_becomes_a_bright_one(films: dict[str, Film]) -> None:
    poster = films["track"].poster
    assert poster.mean() > 100
    # A sky is bluer than it is red.
    assert poster[:5, :, 2].mean() > poster[:5, :, 0].mean() + 20


def test_a_fixed_camera_sees_the_body_leave(films: dict[str, Film]) -> None:
    frames = films["fixed"].frames
    assert len(red(frames[0]))
    assert not len(red(frames[-1]))


def test_two_cameras_are_shown_side_by_side_each_with_its_name(films: dict[str, Film]) -> None:
    result, both = films["both"].result, films["both"].poster
    assert (result.cameras, result.width, result.height) == (["track", "fixed"], 324, 120)
    assert both.shape == (120, 324, 3)
    assert films["both"].frames[0].shape == (120, 324, 3)
    # Below the name each half is what its camera sees alone; between them is the gap.
    np.testing.assert_array_equal(both[40:, :160], films["track"].poster[40:])
    np.testing.assert_array_equal(both[40:, 164:], films["fixed"].poster[40:])
    assert np.ptp(both[:, 160:164].reshape(-1, 3), axis=0).max() == 0
    for left, camera in ((0, "track"), (164, "fixed")):
        above = both[:40, left : left + 160].astype(int)
        assert (above == 255).all(axis=-1).sum() > 20  # its letters
        assert (above < films[camera].poster[:40] - 50).any()  # and the shade behind them


def test_the_body_named_target_stands_where_the_episode_has_its_target(
    films: dict[str, Film], tmp_path: Path
) -> None:
    target = np.array([[-0.8, 0.0, 0.5]] * 3, np.float32)
    episode = replace(rolling_ball(0.1, speed=0.0), target=target)
    render(ball_request(tmp_path, episode, cameras=["fixed"]), timeout_s=60.0)
    [poster] = decoded(tmp_path / "poster.png")
    for name, picture in (("model's", films["fixed"].poster), ("episode's", poster)):
        green = np.argwhere((picture[..., 1] > 90) & (picture[..., 0] < 60) & (picture[..., 2] < 60))
        assert len(green) > 20
        # The camera looks along y: what is at x < 0 is left of the middle.
        assert (green[:, 1].mean() < 80) == (name == "episode's")


def test_a_ghost_goes_where_the_clip_is_unless_it_is_switched_off(tmp_path: Path) -> None:
    still = rolling_ball(0.1, speed=0.0)
    reference = still.qpos + np.array([-0.8, *[0.0] * 6], np.float32)
    for is_drawn in (True, False):
        episode = replace(still, reference=reference)
        render(ball_request(tmp_path, episode, cameras=["fixed"], reference=is_drawn), timeout_s=60.0)
        [poster] = decoded(tmp_path / "poster.png")
        left = poster[:, :60].astype(int)  # The camera looks along y.
        is_teal = (left[..., 1] > left[..., 0] + 40) & (left[..., 2] > left[..., 0] + 40)
        assert (is_teal.sum() > 100) == is_drawn
        assert len(red(poster)) > 100  # The body itself is not translucent.


def test_episodes_follow_one_another_up_to_the_length_asked_for(tmp_path: Path) -> None:
    request = ball_request(tmp_path, rolling_ball(0.5), rolling_ball(0.5), rolling_ball(0.5), seconds=1.2)
    assert render(request, timeout_s=60.0).frames == 12


def test_episodes_at_once_are_below_each_other_and_one_that_has_ended_stands_still_and_dark(
    films: dict[str, Film], tmp_path: Path
) -> None:
    request = ball_request(tmp_path, rolling_ball(0.5), rolling_ball(1.0, speed=0.0), episodes=2, seconds=3.0)
    result = render(request, timeout_s=60.0)
    # 120 + 4 + 120; as long as the longer episode.
    assert (result.width, result.height, result.frames) == (160, 244, 10)
    first, *_, last = decoded(tmp_path / "video.mp4")
    alone = films["track"].frames[0]
    # Right of the words each is what is seen of it alone, as closely as H.264 keeps it.
    for top in (0, 124):
        assert np.abs(first[top : top + 120, 110:].astype(int) - alone[:, 110:]).mean() < 6
    assert last[:120].mean() == pytest.approx(first[:120].mean() / 2, rel=0.15)
    assert last[124:].mean() == pytest.approx(first[124:].mean(), rel=0.05)


@pytest.mark.parametrize(
    ("without", "also"),
    [
        # These are inside of the ball and below it.
        (["transparent"], "contacts"),
        *extra((["transparent"], "centre_of_mass"), (["transparent"], "joints"), ([], "transparent")),
    ],
)
def test_what_is_asked_for_is_drawn_besides_the_body(without: list[str], also: str, tmp_path: Path) -> None:
    pictures: list[NDArray[np.int64]] = []
    ball = rolling_ball(0.1, speed=0.0)
    ball.qpos[:, 2] = 0.29  # A centimetre deep in the floor.
    for number, show in enumerate((without, [*without, also])):
        folder = tmp_path / str(number)
        folder.mkdir()
        request = ball_request(folder, ball, show=show)
        assert render(request, timeout_s=60.0).show == show
        pictures.append(decoded(folder / "poster.png")[0].astype(int))
    # More than a few pixels look different, and all of them near the ball, in the middle of the picture.
    rows, columns = np.argwhere(np.abs(pictures[1] - pictures[0]).max(axis=-1) > 30).T
    assert len(rows) > 5
    assert 10 < rows.min() <= rows.max() < 110
    assert 30 < columns.min() <= columns.max() < 130


def test_an_unknown_camera_is_refused_with_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(RenderingFailed, match="known are track, fixed") as failure:
        render(ball_request(tmp_path, rolling_ball(0.1), cameras=["nose"]), timeout_s=60.0)
    assert failure.value.reason == "bad_request"


def test_a_file_that_is_no_model_is_refused(tmp_path: Path) -> None:
    request = ball_request(tmp_path, rolling_ball(0.1))
    request.model.write_bytes(b"not a model")
    with pytest.raises(RenderingFailed) as failure:
        render(request, timeout_s=60.0)
    assert failure.value.reason == "bad_request"


def test_a_video_that_takes_too_long_leaves_nothing(tmp_path: Path) -> None:
    request = ball_request(tmp_path, rolling_ball(60.0), seconds=60.0, width=640, height=480)
    with pytest.raises(RenderingFailed) as failure:
        render(request, timeout_s=2.0)
    assert failure.value.reason == "timeout"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.mjb", "t.npz"]


def test_memory_does_not_grow_with_the_length_and_no_jax_is_in_it(tmp_path: Path) -> None:
    # Three seconds more are 90 frames of 230 kB: 21 MB, if they were kept.
    size = {"fps": 30, "width": 320, "height": 240}
    short, long = (
        peak_bytes(ball_request(tmp_path, rolling_ball(3.2), seconds=seconds, **size), tmp_path)
        for seconds in (0.2, 3.2)
    )
    assert long - short < 10e6


def test_a_killed_process_leaves_no_half_video_under_the_name(tmp_path: Path) -> None:
    request = ball_request(tmp_path, rolling_ball(60.0), seconds=60.0, width=640, height=480)
    command = [sys.executable, "-m", "worker.render.process", written(request, tmp_path)]
    process = subprocess.Popen(command, env=surroundings(), stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 30
    while not any(path.suffix == ".part" and path.stat().st_size for path in tmp_path.iterdir()):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)  # for the group: no reason to drop a video that its parent waits for
    assert process.poll() is None
    process.kill()
    process.wait(10)
    assert not request.video.exists()
    assert not request.poster.exists()


def surroundings() -> dict[str, str]:
    return {**os.environ, "MUJOCO_GL": probe()[0]}


def written(request: RenderRequest, folder: Path) -> str:
    document = folder / "request.json"
    document.write_text(request.model_dump_json())
    return str(document)


def run_python(code: str, request: RenderRequest, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code, written(request, folder)]
    return subprocess.run(command, env=surroundings(), capture_output=True, text=True, check=False)


def peak_bytes(request: RenderRequest, folder: Path) -> int:
    code = (
        "import resource, sys; from worker.render.process import main; assert main(sys.argv[1:]) == 0;"
        "assert 'jax' not in sys.modules;"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    unit = 1 if sys.platform == "darwin" else 1024
    return int(run_python(code, request, folder).stdout.splitlines()[-1]) * unit


def test_each_episode_is_drawn_in_the_arena_that_it_had(tmp_path: Path) -> None:
    # The ball is 0.3 m, and twice as large in the second episode, whose second begins with frame 10.
    large = np.zeros((3, 3), np.float32)
    large[:, 0] = [40, 0.15, 0.6]
    large[0] = [40, 40, 1]
    first, second = rolling_ball(1.0), replace(rolling_ball(1.0), arena={"geom_size": large})
    render(ball_request(tmp_path, first, second), timeout_s=60.0)
    sizes = [len(red(frame)) for frame in decoded(tmp_path / "video.mp4")]
    assert min(sizes[10:]) > 2 * max(sizes[:10])
