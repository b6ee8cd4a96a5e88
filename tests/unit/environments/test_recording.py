"""The HDF5 file of recorded episodes: its arrays, what their numbers are called, and when there is one."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import mujoco
import numpy as np
import pytest

from core.environments.info import Spaces, in_order, named
from core.environments.recording import RecordingWriter
from core.environments.trajectory import Episode, FollowedClip

MODEL = mujoco.MjModel.from_xml_string(
    """
    <mujoco><worldbody>
      <body name="arm"><joint name="shoulder" axis="0 0 1"/><geom size=".1"/>
        <body pos="1 0 0"><joint name="slider" type="slide"/><geom size=".1"/></body>
      </body>
    </worldbody></mujoco>
    """
)
SPACES = Spaces(
    observation=in_order([named("angle", ["cosine", "sine"], "1"), named("speed", ["shoulder"], "rad/s")]),
    action=in_order([named("torque", ["shoulder"], "N m")]),
)


def opened(path: Path) -> Any:
    """The file; h5py's types do not tell groups from datasets."""
    return h5py.File(path)


def episode(num_steps: int) -> Episode:
    states, draw = num_steps + 1, np.random.default_rng(num_steps)
    arrays = {
        name: draw.normal(size=(states, size)).astype(np.float32)
        for name, size in (("qpos", 2), ("qvel", 2), ("position", 3), ("observation", 3))
    }
    return Episode(
        time=np.linspace(0, num_steps / 2, states),
        action=draw.normal(size=(num_steps, 1)).astype(np.float32),
        reward=np.ones(num_steps, np.float32),
        terminated=num_steps == 2,
        metrics={"x_velocity": np.zeros(num_steps, np.float32)},
        **arrays,
    )


def test_every_number_has_a_name_and_a_unit_and_every_row_a_time(tmp_path: Path) -> None:
    first, second = episode(2), episode(4)
    layer = np.arange(10, dtype=np.float32).reshape(2, 5)
    with RecordingWriter(tmp_path / "r.h5", MODEL, SPACES, [], {"seed": 7, "versions": {"a": "1"}}) as file:
        file.add(first, {"encoder/0": layer})
        file.add(second, {})
    assert [path.name for path in tmp_path.iterdir()] == ["r.h5"]
    with opened(tmp_path / "r.h5") as file:
        about = dict(file.attrs)
        assert (about["format"], about["num_episodes"], about["seed"]) == ("gaitway-recording", 2, 7)
        assert about["versions"] == '{"a": "1"}'
        one = file["episode_0"]
        assert one.attrs["terminated"]
        assert not file["episode_1"].attrs["terminated"]
        for name in ("qpos", "qvel", "observation", "action", "reward"):
            np.testing.assert_array_equal(one[name], getattr(first, name))
        np.testing.assert_array_equal(one["activations/encoder/0"], layer)
        assert one["metrics/x_velocity"].attrs["unit"] == "m/s"
        seen = one["observation"]
        assert [dimension.label for dimension in seen.dims] == ["time", "observation"]
        assert [*seen.dims[1]["names"].asstr()] == ["angle/cosine", "angle/sine", "speed/shoulder"]
        assert [*seen.dims[1]["units"].asstr()] == ["1", "1", "rad/s"]
        np.testing.assert_array_equal(seen.dims[0]["time"], [0.0, 0.5, 1.0])
        np.testing.assert_array_equal(one["action"].dims[0]["action_time"], [0.0, 0.5])
        assert [*one["qpos"].dims[1]["units"].asstr()] == ["rad", "m"]
        assert [*one["body_position"].dims[1]["names"].asstr()] == ["arm", "body 2"]
        # The arm's end is 1 m from the shoulder, and by its slide further along z.
        angle, out = first.qpos[1]
        there = [np.cos(angle), np.sin(angle), out]
        np.testing.assert_allclose(one["body_position"][1, 1], there, rtol=1e-5)
        assert one["body_position"].attrs["unit"] == "m"


def test_a_frame_of_the_reference_is_a_clip_and_a_frame_of_it(tmp_path: Path) -> None:
    clips = [FollowedClip("walk", 0, 10), FollowedClip("turn", 10, 5)]
    following = replace(episode(2), reference_frame=np.array([9, 10, 12], np.int32))
    with RecordingWriter(tmp_path / "r.h5", MODEL, SPACES, clips, {}) as file:
        file.add(following, {})
    with opened(tmp_path / "r.h5") as file:
        names = file["names/clip"].asstr()[:][file["episode_0/clip"][:]]
        assert [*names] == ["walk", "turn", "turn"]
        assert [*file["episode_0/clip_frame"]] == [9, 0, 2]
        assert [*file["names/clip"].attrs["num_frames"]] == [10, 5]


def test_a_recording_that_fails_leaves_no_file(tmp_path: Path) -> None:
    def diverge() -> None:
        with RecordingWriter(tmp_path / "r.h5", MODEL, SPACES, [], {}) as file:
            file.add(episode(2), {})
            raise RuntimeError("diverged")

    with pytest.raises(RuntimeError, match="diverged"):
        diverge()
    assert list(tmp_path.iterdir()) == []
