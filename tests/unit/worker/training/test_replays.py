"""What a worker keeps for replays, and how much of a training's time they take."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import mujoco
import pytest

from core.jobs.spec import EnvironmentSpec, RandomPolicy, RolloutSpec, TrainSpec
from core.rendering.replay.replay_file import read_replay
from tests.unit.rendering.conftest import BALL, rolling_ball
from worker.training import exports, video
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter
from worker.training.exports import TimeBudget
from worker.training.video import MOST_EPISODES, ReplayWriter


@pytest.fixture
def pipe(tmp_path: Path) -> Iterator[tuple[EventWriter, int]]:
    read, write = os.pipe()
    os.set_blocking(read, False)
    events = EventWriter(tmp_path, write)
    yield events, read
    events._pipe.close()
    os.close(read)


def writer(events: EventWriter) -> ReplayWriter:
    environment = SimpleNamespace(model=mujoco.MjModel.from_xml_string(BALL), tracked_body=2)
    return ReplayWriter(cast(BuiltEnvironment, SimpleNamespace(environment=environment)), events)


def said(read: int) -> list[dict[str, Any]]:
    return [json.loads(line) for line in os.read(read, 65536).splitlines()]


def test_the_scene_is_kept_once_and_a_replay_each_time(pipe: tuple[EventWriter, int], tmp_path: Path) -> None:
    events, read = pipe
    replay = writer(events)
    replay.keep([rolling_ball(1.0)], "-000000000100", 100)
    replay.keep([rolling_ball(0.5), rolling_ball(1.0)], "", 200)
    files = said(read)
    assert [(file["name"], file["role"], file["step"]) for file in files] == [
        ("scene.glb", "scene", None),
        ("replay-000000000100.bin", "replay", 100),
        ("replay.bin", "replay", 200),
    ]
    header, episodes = read_replay((tmp_path / "replay.bin").read_bytes())
    # The ball slides at 3 m/s: 1.5 m in half a second, 3 m in one.
    assert [round(float(one["origin"][-1, 0]), 3) for one in episodes] == [1.5, 3.0]
    assert header["target_body"] == 1


def test_of_many_episodes_the_first_are_kept_and_their_number_is_told(pipe: tuple[EventWriter, int]) -> None:
    events, read = pipe
    writer(events).keep([rolling_ball(0.1)] * (MOST_EPISODES + 3), "", None)
    facts = said(read)[1]["metadata"]
    assert (facts["episodes"], facts["of_episodes"]) == (MOST_EPISODES, MOST_EPISODES + 3)


def test_a_body_that_cannot_be_shown_costs_no_job(
    pipe: tuple[EventWriter, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> bytes:
        raise KeyError("float64")

    monkeypatch.setattr(video, "scene_of", fail)
    events, read = pipe
    writer(events).keep([rolling_ball(0.1)], "", None)
    [note] = said(read)
    assert (note["type"], note["text"]) == ("note", "There is no replay: KeyError: 'float64'")


def test_a_video_that_was_not_ready_leaves_the_replay_and_a_way_to_get_one() -> None:
    late = "The video was not ready within 120 s."
    training = TrainSpec(environment=EnvironmentSpec(id="ant"))
    rollout = RolloutSpec(environment=EnvironmentSpec(id="ant"), policy=RandomPolicy())
    said = f"There is no video: {late} The replay on the job's page shows the same episodes"
    assert video.no_video(late, rollout) == f"{said}."
    assert video.no_video(late, training) == f"{said}; `gaitway rollout JOB` draws a video later."


def test_replays_take_a_small_share_of_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(exports.time, "monotonic", lambda: now)
    budget = TimeBudget(share=0.05)
    assert budget.allows_another()
    now = 30.0  # The first compiled for 30 s, which the video at the end needs, too.
    budget.spent(0.0)
    assert budget.allows_another()
    now = 32.0
    budget.spent(30.0)  # 2 s are 5 % of 40 s.
    now = 71.0
    assert not budget.allows_another()
    now = 72.5
    assert budget.allows_another()
