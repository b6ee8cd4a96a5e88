import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from core.environments import trajectory
from core.environments.trajectory import Episode, Trajectory

BODY = """
<mujoco>
  <worldbody><body><freejoint name="root"/><geom size="0.1"/>
    <body><joint name="knee"/><geom size="0.1"/></body></body></worldbody>
  <actuator><motor name="knee_motor" joint="knee"/></actuator>
</mujoco>
"""


def episode(num_steps: int, *, speed: float, terminated: bool = False) -> Episode:
    time = 0.1 * np.arange(num_steps + 1)
    position = np.zeros((num_steps + 1, 3), np.float32)
    position[:, 0] = speed * time
    return Episode(
        time=time,
        qpos=np.zeros((num_steps + 1, 8), np.float32),
        qvel=np.zeros((num_steps + 1, 7), np.float32),
        position=position,
        observation=np.ones((num_steps + 1, 3), np.float32),
        action=np.zeros((num_steps, 1), np.float32),
        reward=np.full(num_steps, 2.0, np.float32),
        terminated=terminated,
        metrics={"x_velocity": np.full(num_steps, speed, np.float32)},
    )


@pytest.fixture
def two_episodes() -> Trajectory:
    about = trajectory.describe(mujoco.MjModel.from_xml_string(BODY), environment="a body", seed=3)
    return Trajectory([episode(5, speed=1.0), episode(15, speed=3.0, terminated=True)], about)


def test_what_is_saved_is_loaded(two_episodes: Trajectory, tmp_path: Path) -> None:
    trajectory.save(tmp_path / "t.npz", two_episodes)
    back = trajectory.load(tmp_path / "t.npz")
    assert [e.terminated for e in back.episodes] == [False, True]
    for stored, original in zip(back.episodes, two_episodes.episodes, strict=True):
        np.testing.assert_array_equal(stored.position, original.position)
        np.testing.assert_array_equal(stored.metrics["x_velocity"], original.metrics["x_velocity"])
        assert stored.time.dtype == np.float64


def test_the_file_explains_itself_to_whoever_has_numpy_alone(
    two_episodes: Trajectory, tmp_path: Path
) -> None:
    trajectory.save(tmp_path / "t.npz", two_episodes)
    with np.load(tmp_path / "t.npz", allow_pickle=False) as file:
        about = json.loads(str(file["about"]))
        described = {name.replace("<i>", "0").replace("<name>", "x_velocity") for name in about["arrays"]}
        assert described == {name for name in file.files if name.startswith("episode_0/")}
    assert about["arrays"]["episode_<i>/time"]["unit"] == "s"
    assert about["environment"] == "a body"
    assert about["actuators"] == ["knee_motor"]
    # A free joint takes 7 positions and 6 velocities.
    assert about["joints"] == [
        {"name": "root", "type": "free", "qpos_start": 0, "qvel_start": 0},
        {"name": "knee", "type": "hinge", "qpos_start": 7, "qvel_start": 6},
    ]


def test_what_only_some_episodes_have_is_kept_and_explained(two_episodes: Trajectory, tmp_path: Path) -> None:
    first, second = two_episodes.episodes
    target, told = np.full((6, 2), 0.5, np.float32), np.full((6, 3), 0.25, np.float32)
    own = replace(first, target=target, command=told, velocity=2 * told, reference=first.qpos)
    trajectory.save(tmp_path / "t.npz", Trajectory([own, second], two_episodes.about))
    back = trajectory.load(tmp_path / "t.npz")
    np.testing.assert_array_equal(back.episodes[0].target, target)
    np.testing.assert_array_equal(back.episodes[0].command, told)
    np.testing.assert_array_equal(back.episodes[0].reference, first.qpos)
    np.testing.assert_array_equal(back.episodes[0].velocity, 2 * told)
    assert back.episodes[1].target is back.episodes[1].command is back.episodes[1].velocity is None
    assert back.about["arrays"]["episode_<i>/target"]["unit"] == "m"
    assert "episode_<i>/target" not in two_episodes.about["arrays"]


def test_equal_trajectories_give_equal_bytes(two_episodes: Trajectory, tmp_path: Path) -> None:
    trajectory.save(tmp_path / "a.npz", two_episodes)
    trajectory.save(tmp_path / "b.npz", trajectory.load(tmp_path / "a.npz"))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert len(list(tmp_path.iterdir())) == 2


def test_another_npz_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with pytest.raises(ValueError, match="is not a trajectory"):
        trajectory.load(tmp_path / "other.npz")
    np.savez(tmp_path / "newer.npz", about=np.array('{"format": "gaitway-trajectory", "version": 2}'))
    with pytest.raises(ValueError, match="version 1"):
        trajectory.load(tmp_path / "newer.npz")


def test_the_summary_says_how_far_and_how_fast(two_episodes: Trajectory) -> None:
    # 0.5 s at 1 m/s and 1.5 s at 3 m/s: 0.5 m and 4.5 m, together 5 m in 2 s.
    got = trajectory.summary(two_episodes)
    assert (got["num_episodes"], got["num_terminated"]) == (2, 1)
    assert got["forward_speed_m_s"] == pytest.approx(2.5)
    assert got["mean"]["forward_speed_m_s"] == pytest.approx(2.0)
    assert got["std"]["return"] == pytest.approx(10.0)
    assert [row["return"] for row in got["episodes"]] == [10.0, 30.0]
    assert [row["distance_m"] for row in got["episodes"]] == pytest.approx([0.5, 4.5])
    assert json.loads(json.dumps(got)) == got
