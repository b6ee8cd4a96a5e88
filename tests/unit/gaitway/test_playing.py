"""`gaitway play`: a body in a viewer on the user's machine, or in a video where there is no display."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from core.environments.trajectory import Episode
from gaitway.cli.main import app
from gaitway.service.playing import Keys, Player
from tests.unit.gaitway.test_foreground import trained

# Two bodies on rails: the first is driven; the second marks the target.
RAIL = """<mujoco><worldbody>
  <body name="sled"><joint type="slide" axis="1 0 0"/><geom name="hull" size=".1"/></body>
  <body name="target" pos="0 0 1"/>
</worldbody></mujoco>"""
SPACE, ENTER = 32, 257


@dataclass
class Window:
    """A viewer without a screen: it keeps what it is shown, and is closed after `lasts` pictures."""

    data: mujoco.MjData
    model: mujoco.MjModel
    lasts: int
    cam: mujoco.MjvCamera = field(default_factory=mujoco.MjvCamera)
    shown: list[float] = field(default_factory=list[float])
    targets: list[float] = field(default_factory=list[float])
    sizes: list[float] = field(default_factory=list[float])

    def is_running(self) -> bool:
        return len(self.shown) < self.lasts

    def lock(self) -> AbstractContextManager[None]:
        return nullcontext()

    def sync(self) -> None:
        self.shown.append(round(float(self.data.xpos[1, 0]), 3))
        self.targets.append(float(self.data.xpos[2, 0]))
        self.sizes.append(float(self.model.geom_size[0, 0]))


def episode(first: float, num_steps: int = 6) -> Episode:
    """The sled begins at `first`, in m, and moves 0.1 m a frame of the viewer, which are its steps, too."""
    states = num_steps + 1
    qpos = (first + 0.1 * np.arange(states))[:, None].astype(np.float32)
    return Episode(
        time=np.arange(states) / 60,
        qpos=qpos,
        qvel=np.zeros_like(qpos),
        position=np.zeros((states, 3), np.float32),
        observation=qpos,
        action=np.zeros((num_steps, 1), np.float32),
        reward=np.ones(num_steps, np.float32),
        terminated=False,
    )


def window(lasts: int = 10_000) -> Window:
    model = mujoco.MjModel.from_xml_string(RAIL)
    return Window(mujoco.MjData(model), model, lasts)


def shown(seen: Window, episodes: list[Episode], keys: dict[int, int] | None = None) -> list[float]:
    """The sled's positions in the pictures. keys: which key is pressed after so many of them."""
    pressed = Keys()

    def sleep(seconds: float) -> None:
        assert seconds == pytest.approx(1 / 60)
        if (key := (keys or {}).get(len(seen.shown))) is not None:
            pressed(key)

    Player(seen, seen.model, seen.data, pressed, sleep).show(episodes, body=1)
    return seen.shown


def test_episodes_are_shown_in_turn_frame_by_frame() -> None:
    one = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    assert shown(window(), [episode(0), episode(2)]) == [*one, *(round(2 + x, 3) for x in one)]


def test_nothing_is_shown_in_a_closed_viewer() -> None:
    def endless() -> Iterator[Episode]:
        while True:
            yield episode(0)

    seen = window(lasts=9)
    Player(seen, seen.model, seen.data, Keys(), lambda _: None).show(endless(), body=1)
    assert len(seen.shown) == 9


def test_space_pauses_and_enter_begins_the_next_episode() -> None:
    paused = shown(window(), [episode(0)], {2: SPACE, 5: SPACE})
    assert paused == [0.0, 0.1, 0.1, 0.1, 0.1, 0.2, 0.3, 0.4, 0.5]
    assert shown(window(), [episode(0), episode(2)], {2: ENTER})[:4] == [0.0, 0.1, 2.0, 2.1]
    # A viewer that is closed while it is paused ends, too.
    assert shown(window(lasts=4), [episode(0)], {2: SPACE}) == [0.0, 0.1, 0.1, 0.1]


def test_the_target_and_the_arena_are_those_of_the_episode() -> None:
    seen, target = window(), np.full((7, 2), 3.0, np.float32)
    arena = {"geom_size": np.full((1, 3), 0.25, np.float32)}
    shown(seen, [replace(episode(0), target=target, arena=arena)])
    assert (set(seen.targets), set(seen.sizes)) == ({3.0}, {0.25})


def test_the_camera_follows_the_body() -> None:
    seen = window(lasts=1)
    shown(seen, [episode(0)])
    assert (seen.cam.type, seen.cam.trackbodyid) == (mujoco.mjtCamera.mjCAMERA_TRACKING, 1)


def test_an_episode_is_shown_up_to_numbers_that_are_not_finite(capsys: pytest.CaptureFixture[str]) -> None:
    broken = episode(0)
    broken.qpos[4] = np.nan
    assert shown(window(), [broken]) == [0.0, 0.1, 0.2]
    assert "the qpos became non-finite at step 4" in capsys.readouterr().err


@pytest.mark.timeout(300)
def test_without_a_display_there_is_a_video(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    status, printed = trained(tmp_path, "inverted_pendulum", "--agent", "zero", command="play")
    assert status == 0, printed
    folder = tmp_path / "gaitway-play" / "inverted_pendulum"
    assert f"There is no display here; the video is {folder}/video.mp4" in printed
    assert (folder / "video.mp4").stat().st_size
    assert (folder / "replay.bin").stat().st_size


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["antt"], "Did you mean 'ant'?"),
        (["ant", "--agent", "trained"], "An environment has no trained policy: name a job"),
        (["ant", "--set", "gravity=3", "--video"], "The options of 'ant' are not valid"),
    ],
)
def test_what_cannot_be_played_is_refused(
    arguments: list[str], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["play", *arguments])
    assert (result.exit_code, sentence in result.output) == (2, True), result.output
