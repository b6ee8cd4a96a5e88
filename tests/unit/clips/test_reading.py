"""Each format, by a file that is real or made as its authors make it; what is no clip is refused."""

import io
import pickle
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import h5py
import mujoco
import numpy as np
import pytest

from core.clips import archive
from core.clips.clip import Clip, with_velocities
from core.clips.formats import hdf5
from core.clips.kinematics import poses, qpos
from core.clips.reading import read
from core.clips.skeleton import skeleton_of
from core.environments import trajectory
from core.environments.trajectory import Episode, Trajectory
from core.errors import BadClips
from tests.unit.clips.bodies import BY_DEPTH, JOINTS, WALKER, walker, walking

WALK = walking()
ROWS = np.concatenate([WALK.root_position, WALK.root_orientation, WALK.joint_positions], axis=1)


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return walker()


def same(found: Clip, expected: Clip = WALK) -> None:
    np.testing.assert_allclose(found.root_position, expected.root_position, atol=1e-6)
    np.testing.assert_allclose(found.root_orientation, expected.root_orientation, atol=1e-6)
    np.testing.assert_allclose(found.joint_positions, expected.joint_positions, atol=1e-6)
    assert (found.rate, found.joints) == (expected.rate, expected.joints)
    assert found.joint_velocities is not None


def npz(path: Path, **contents: Any) -> Path:
    np.savez(path / "file.npz", **contents)
    return path / "file.npz"


def npy(values: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, values)
    return file.getvalue()


def bodies(model: mujoco.MjModel) -> dict[str, Any]:
    """As BeyondMimic stores them: the body's, without the world."""
    found = poses(qpos(WALK, skeleton_of(model)), model)
    quaternions = np.empty((*found.body_positions.shape[:2], 4))
    for frame in range(len(quaternions)):
        for body in range(model.nbody):
            mujoco.mju_mat2Quat(quaternions[frame, body], found.body_turns[frame, body].ravel())
    return {"body_pos_w": found.body_positions[:, 1:], "body_quat_w": quaternions[:, 1:]}


class TestMjlab:
    def test_the_root_is_in_front_of_the_joints(self, model: mujoco.MjModel, tmp_path: Path) -> None:
        order = [*reversed(JOINTS)]
        file = npz(
            tmp_path,
            fps=np.array([30]),
            joint_names=np.array(order),
            joint_pos=np.concatenate([ROWS[:, :7], ROWS[:, :6:-1]], axis=1),
        )
        found = read(file, model, name="walk")
        assert (found.format, found.clips[0].name) == ("mjlab", "walk")
        same(found.clips[0])

    def test_the_root_is_the_first_body(self, model: mujoco.MjModel, tmp_path: Path) -> None:
        same(read(npz(tmp_path, fps=30, joint_pos=WALK.joint_positions, **bodies(model)), model).clips[0])

    def test_joints_without_names_are_in_the_order_that_puts_bodies_where_the_file_has_them(
        self, model: mujoco.MjModel, tmp_path: Path
    ) -> None:
        by_depth = WALK.joint_positions[:, [JOINTS.index(name) for name in BY_DEPTH]]
        same(read(npz(tmp_path, fps=30, joint_pos=by_depth, **bodies(model)), model).clips[0])

    def test_pickled_objects_are_not_read(self, model: mujoco.MjModel, tmp_path: Path) -> None:
        file = npz(tmp_path, joint_pos=ROWS, joint_names=np.array([{}], dtype=object))
        with pytest.raises(BadClips, match="pickled objects, which are not read"):
            read(file, model)


class TestLafan:
    def test_quaternions_are_x_y_z_w(self, model: mujoco.MjModel, tmp_path: Path) -> None:
        file = tmp_path / "walk1_subject1.csv"
        np.savetxt(file, ROWS[:, [0, 1, 2, 4, 5, 6, 3, *range(7, 14)]], delimiter=",", fmt="%.6f")
        found = read(file, model, rate=30)
        assert found.format == "lafan"
        same(found.clips[0])

    def test_a_header_names_the_joints(self, model: mujoco.MjModel, tmp_path: Path) -> None:
        file = tmp_path / "walk.csv"
        header = "x,y,z,qx,qy,qz,qw," + ",".join(reversed(JOINTS))
        rows = ROWS[:, [0, 1, 2, 4, 5, 6, 3, *range(13, 6, -1)]]
        np.savetxt(file, rows, delimiter=",", header=header, comments="")
        same(read(file, model, rate=30).clips[0])

    @pytest.mark.parametrize(
        ("text", "sentence"),
        [
            ("0,0,1,0,0,0,1,0.1\n0,0,1,0,0,0\n", "Line 2 has 6 numbers, the first one 8"),
            ("0,0,1,0,0,0,1,0.1\n0,0,1,0,0,0,1,left\n", "Line 2 of the file is not numbers"),
            ("0,0,1\n", "A line has 3 numbers"),
            ("0,0,1,0,0,0,1,0,0,0\n", "it has 3 joints, without names, and the body has 7"),
            ("a,b\n0,0,1,0,0,0,1,0.1\n", "The header has 2 names, but line 2 has 8 numbers"),
            ("", "The file is empty"),
            ("not a clip\n", "The file has no line of numbers"),
        ],
    )
    def test_a_bad_line_is_named(
        self, model: mujoco.MjModel, tmp_path: Path, text: str, sentence: str
    ) -> None:
        (tmp_path / "bad.csv").write_text(text)
        with pytest.raises(BadClips, match=sentence):
            read(tmp_path / "bad.csv", model, rate=30)


class TestStac:
    NAMES = np.array(["root"] * 7 + list(JOINTS), dtype="S")

    def test_qpos_goes_by_its_names_and_is_cut_as_configured(
        self, model: mujoco.MjModel, tmp_path: Path
    ) -> None:
        with h5py.File(tmp_path / "ik.h5", "w") as file:
            file["qpos"] = np.concatenate([ROWS, ROWS])
            file["qvel"] = np.array([])  # stac-mjx leaves it so without infer_qvels
            file["names_qpos"] = self.NAMES
            file["config"] = np.bytes_(b"model:\n  RENDER_FPS: 30\nstac:\n  n_frames_per_clip: 61\n")
        found = read(tmp_path / "ik.h5", model, rate=30, name="rat")
        assert (found.format, [clip.name for clip in found.clips]) == ("stac-mjx", ["clip_0", "clip_1"])
        for clip in found.clips:
            same(clip)
        with pytest.raises(BadClips, match=r"give `rate`\. Its configuration draws 30 a second"):
            read(tmp_path / "ik.h5", model)

    def test_names_may_carry_the_bodys_name(self, model: mujoco.MjModel, tmp_path: Path) -> None:
        with h5py.File(tmp_path / "ik.h5", "w") as file:
            file["qpos"] = ROWS
            file["names_qpos"] = np.array(["root"] + [f"walker/{name}-rodent" for name in JOINTS], dtype="S")
        same(read(tmp_path / "ik.h5", model, rate=30).clips[0])

    def test_groups_are_clips(self, model: mujoco.MjModel, tmp_path: Path) -> None:
        with h5py.File(tmp_path / "bouts.h5", "w") as file:
            file["names_qpos"] = self.NAMES
            file["bout_000/qpos"] = ROWS
            file["bout_001/qpos"] = ROWS[:31]
        found = read(tmp_path / "bouts.h5", model, rate=30)
        assert [(clip.name, clip.num_frames) for clip in found.clips] == [("bout_000", 61), ("bout_001", 31)]

    def test_track_mjx_stacks_clips_of_one_length(self, model: mujoco.MjModel, tmp_path: Path) -> None:
        with h5py.File(tmp_path / "reference.h5", "w") as file:
            file["all_clips/position"] = np.stack([WALK.root_position] * 2)
            file["all_clips/quaternion"] = np.stack([WALK.root_orientation] * 2)
            file["all_clips/joints"] = np.stack([WALK.joint_positions] * 2)
        found = read(tmp_path / "reference.h5", model, rate=30)
        assert [clip.name for clip in found.clips] == ["all_clips_0", "all_clips_1"]
        same(found.clips[1])

    def test_links_out_of_the_file_are_not_followed(self, model: mujoco.MjModel, tmp_path: Path) -> None:
        with h5py.File(tmp_path / "other.h5", "w") as file:
            file["qpos"] = ROWS
        with h5py.File(tmp_path / "link.h5", "w") as file:
            file["qpos"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/qpos")
        with pytest.raises(BadClips, match="The HDF5 file has nothing, which is no known format"):
            read(tmp_path / "link.h5", model, rate=30)

    def test_an_array_in_place_of_a_group_is_said(self, model: mujoco.MjModel, tmp_path: Path) -> None:
        with h5py.File(tmp_path / "mocap.h5", "w") as file:
            file["clip/walkers"] = ROWS
        with pytest.raises(BadClips, match="`/clip/walkers` is an array, not a group"):
            read(tmp_path / "mocap.h5", model)

    def test_a_cut_off_file_is_refused(self, model: mujoco.MjModel, tmp_path: Path) -> None:
        with h5py.File(tmp_path / "ik.h5", "w") as file:
            file["qpos"] = ROWS
        (tmp_path / "half.h5").write_bytes((tmp_path / "ik.h5").read_bytes()[:3000])
        with pytest.raises(BadClips, match="HDF5 file is not whole"):
            read(tmp_path / "half.h5", model, rate=30)


def test_dm_controls_clips_are_of_its_humanoid() -> None:
    pytest.importorskip("dm_control")
    spec = find_spec("dm_control")
    assert spec is not None
    assert spec.origin is not None
    folder = Path(spec.origin).parent / "locomotion"
    humanoid = mujoco.MjSpec.from_file(str(folder / "walkers" / "assets" / "humanoid_CMU_V2019.xml"))
    humanoid.compiler.degree = False  # as dm_control has it, with the free joint
    humanoid.body("root").add_freejoint()
    body = humanoid.compile()
    found = read(folder / "mocap" / "test_trajectories.h5", body)
    assert found.format == "dm_control"
    facts = [(clip.name, clip.num_frames, clip.rate) for clip in found.clips]
    assert facts == [("cmuv2019_001", 10, 20.0), ("cmuv2019_002", 10, 20.0)]
    assert found.clips[0].joints == skeleton_of(body).joints
    # The file's own forward kinematics: its bodies lie where ours do.
    with h5py.File(folder / "mocap" / "test_trajectories.h5") as file:
        theirs = file["cmuv2019_001/walkers/walker_0/body_positions"][:, 3].reshape(-1, 3)
    ours = poses(qpos(found.clips[0], skeleton_of(body))[3:4], body).body_positions[0, 1:]
    nearest = np.linalg.norm(ours[:, None] - theirs[None], axis=-1).min(axis=1)
    assert nearest.max() < 1e-3


def test_our_trajectories_keep_their_velocities(tmp_path: Path) -> None:
    # A box stands beside the body; it comes first in the model.
    box = '<body pos="2 0 0.2"><freejoint/><geom type="box" size="0.2 0.2 0.2"/></body>'
    model = mujoco.MjModel.from_xml_string(WALKER.replace('<body name="torso"', box + '<body name="torso"'))
    moving = with_velocities(WALK)
    speeds = np.concatenate(
        [np.zeros((61, 6)), np.full((61, 3), 0.5), np.full((61, 3), 0.25), np.full((61, 7), 0.125)], axis=1
    )
    episode = Episode(
        time=np.arange(61) / 30,
        qpos=qpos(moving, skeleton_of(model)).astype(np.float32),
        qvel=speeds.astype(np.float32),
        position=moving.root_position.astype(np.float32),
        observation=np.zeros((61, 1), np.float32),
        action=np.zeros((60, 1), np.float32),
        reward=np.zeros(60, np.float32),
        terminated=False,
    )
    trajectory.save(tmp_path / "t.npz", Trajectory([episode] * 2, trajectory.describe(model)))
    found = read(tmp_path / "t.npz", model)
    assert (found.format, [clip.name for clip in found.clips]) == ("trajectory", ["episode_0", "episode_1"])
    same(found.clips[1])
    assert (found.clips[0].joint_velocities == 0.125).all()
    assert (found.clips[0].root_angular_velocity == 0.25).all()


def test_our_own_file_of_clips_is_read_again(model: mujoco.MjModel, tmp_path: Path) -> None:
    (tmp_path / "clips.npz").write_bytes(archive.to_bytes([WALK, WALK]))
    found = read(tmp_path / "clips.npz", model)
    assert [clip.name for clip in found.clips] == ["walk", "walk_2"]
    same(found.clips[0])


def damaged(folder: Path, before: bytes, after: bytes) -> bytes:
    """An NPZ file of one array that is not compressed, with other bytes in one place, and their checksum."""
    with zipfile.ZipFile(npz(folder, joint_pos=ROWS)) as packed:
        content = packed.read("joint_pos.npy")
    assert before in content
    assert len(before) == len(after)
    with zipfile.ZipFile(buffer := io.BytesIO(), "w") as packed:
        packed.writestr("joint_pos.npy", content.replace(before, after))
        packed.writestr("joint_names.npy", npy(np.array(JOINTS)))
    return buffer.getvalue()


def test_a_damaged_header_of_an_array_is_refused(model: mujoco.MjModel, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(damaged(tmp_path, b"), }", b"(, }"))
    with pytest.raises(BadClips, match=r"The NPZ file .*\.$"):
        read(tmp_path / "file", model)


def test_an_encrypted_file_is_refused(model: mujoco.MjModel, tmp_path: Path) -> None:
    content = bytearray(npz(tmp_path, joint_pos=ROWS).read_bytes())
    for mark, place in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.index(mark) + place] |= 1
    (tmp_path / "file").write_bytes(content)
    with pytest.raises(BadClips, match="encrypted"):
        read(tmp_path / "file", model)


@pytest.mark.parametrize("error", [OSError, RuntimeError, KeyError, TypeError, ValueError])
def test_whatever_h5py_says_of_damage_is_a_refusal(tmp_path: Path, error: type[Exception]) -> None:
    with h5py.File(tmp_path / "file", "w"):
        pass
    with pytest.raises(BadClips, match="The HDF5 file is damaged"), hdf5.opened(tmp_path / "file"):
        raise error("no such type")


@pytest.mark.parametrize(
    ("write", "sentence"),
    [
        (lambda file: file.write_bytes(pickle.dumps({"qpos": 1})), "pickled Python, which is not read"),
        (lambda file: file.write_bytes(npy(ROWS)), r"single NumPy array \(\.npy\)"),
        (lambda file: npz(file.parent, poses=ROWS).rename(file), "has `poses`, which is no known format"),
        (lambda file: file.write_bytes(b"PK\x03\x04 and no more"), "NPZ file is not whole"),
        (lambda file: file.write_bytes(bytes(range(128, 256))), "pickled Python"),
        (lambda file: file.write_bytes(b"\xff\xfe\xff"), "neither NPZ nor HDF5, nor text"),
        (
            lambda file: npz(file.parent, about=np.array('{"format": "gaitway-trajectory"}')).rename(file),
            "The trajectory is not whole",
        ),
    ],
)
def test_what_is_no_clip_is_refused(
    model: mujoco.MjModel, tmp_path: Path, write: Callable[[Path], object], sentence: str
) -> None:
    write(tmp_path / "file")
    with pytest.raises(BadClips, match=sentence):
        read(tmp_path / "file", model)


class TestRate:
    def file(self, folder: Path, **facts: Any) -> Path:
        return npz(folder, joint_pos=ROWS, joint_names=np.array(JOINTS), **facts)

    def test_a_file_without_one_needs_it(self, model: mujoco.MjModel, tmp_path: Path) -> None:
        with pytest.raises(BadClips, match="does not say how many frames a second it has: give `rate`"):
            read(self.file(tmp_path), model)

    def test_a_file_with_another_is_refused(self, model: mujoco.MjModel, tmp_path: Path) -> None:
        with pytest.raises(BadClips, match="says that it has 30 frames a second, and `rate` 60"):
            read(self.file(tmp_path, fps=30), model, rate=60)

    @pytest.mark.parametrize("fps", [0, -1, np.nan])
    def test_one_that_is_none_is_refused(self, model: mujoco.MjModel, tmp_path: Path, fps: float) -> None:
        with pytest.raises(BadClips, match="frames a second: it must be more than 0"):
            read(self.file(tmp_path, fps=fps), model)
