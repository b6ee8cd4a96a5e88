"""Recordings of key points in files of others: how they are read, what is said of them, what is refused."""

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import mujoco
import numpy as np
import pytest

from core.clips import key_points
from core.clips.formats import key_points as key_points_of
from core.clips.formats import lafan
from core.clips.formats.key_points import KeyPoints
from core.clips.reading import Reading, read
from core.errors import BadClips
from tests.unit.clips.bodies import walker
from tests.unit.clips.test_inverse_kinematics import MAPPING, MOTION, NAMES, seen

TIMES = 7.0 + np.arange(MOTION.num_frames) / 15
POINTS = {name: {"body": point.body, "offset": point.offset} for name, point in MAPPING.items()}


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return walker()


def npz(path: Path, **arrays: Any) -> None:
    with path.open("wb") as file:
        np.savez(file, **arrays)


def hdf5(path: Path, **arrays: Any) -> None:
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values


def nwb(path: Path, points: Any, times: Any = TIMES) -> None:
    """As pynwb with ndx-pose writes it, in millimetres."""
    with h5py.File(path, "w") as file:
        group = file.create_group("processing/behavior/PoseEstimation")
        group.attrs["neurodata_type"] = "PoseEstimation"
        for place, name in enumerate(NAMES):
            series = group.create_group(name)
            series["data"] = points[:, place] * 1000
            series["data"].attrs["conversion"] = 0.001
            series["timestamps"] = times


def anipose(path: Path, points: Any) -> None:
    header = ",".join(f"{name}_x,{name}_y,{name}_z,{name}_score" for name in NAMES)
    rows = [
        ",".join("" if np.isnan(value) else f"{value:.6f}" for point in row for value in (*point, 0.9))
        for row in points
    ]
    path.write_text("\n".join([f"{header},fnum", *(f"{row},{i}" for i, row in enumerate(rows))]))


def deeplabcut(path: Path, points: Any) -> None:
    lines = [
        "scorer," + ",".join("DLC" for _ in NAMES for _ in "xyz"),
        "bodyparts," + ",".join(name for name in NAMES for _ in "xyz"),
        "coords," + ",".join("xyz" for _ in NAMES).replace("xyz", "x,y,z"),
        *(f"{frame}," + ",".join(map(str, row.ravel())) for frame, row in enumerate(points)),
    ]
    path.write_text("\n".join(lines))


def dannce(path: Path, points: Any) -> None:
    import scipy.io

    scipy.io.savemat(path, {"pred": points.transpose(0, 2, 1) * 1000, "sampleID": np.arange(len(points))})


def dannce_of_matlab(path: Path, points: Any) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        file["names"] = np.zeros((1, len(NAMES)), "u8")  # It stores texts as references.
        file["pred"] = points.transpose(0, 2, 1).T  # MATLAB's axes are the other way round.
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")


LAYOUTS: dict[str, Callable[[Path, Any], None]] = {
    "npz": lambda path, points: npz(path, key_points=points, names=np.array(NAMES), fps=15.0),
    "sleap": lambda path, points: hdf5(path, tracks=points[:, None], node_names=np.array(NAMES, "S")),
    "sleap-analysis": lambda path, points: hdf5(path, tracks=points.T[None], node_names=np.array(NAMES, "S")),
    "nwb": nwb,
    "anipose": anipose,
    "deeplabcut": deeplabcut,
    "dannce": dannce,
    "matlab": dannce_of_matlab,
}


def sent(path: Path, options: dict[str, Any] | None = None) -> Path:
    """The recording in a ZIP with `points.json`."""
    packed = path.with_suffix(".zip")
    with zipfile.ZipFile(packed, "w") as file:
        file.writestr("points.json", json.dumps({"points": POINTS} if options is None else options))
        file.write(path, "a folder/recording")
    return packed


def found_in(path: Path, model: mujoco.MjModel, options: dict[str, Any] | None = None) -> Reading:
    return read(sent(path, options), model, rate=15.0, name="walk")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_motion_comes_back_from_a_file(layout: str, model: mujoco.MjModel, tmp_path: Path) -> None:
    LAYOUTS[layout](tmp_path / "sent", seen(model))
    nameless = layout in ("dannce", "matlab")
    options = {"points": POINTS, "fit_offsets": 0, **({"names": NAMES} if nameless else {})}
    found = found_in(tmp_path / "sent", model, options)
    [clip] = found.clips
    assert (found.format, clip.name, clip.rate) == ("key points", "walk", 15.0)
    # The neck turns by up to 0.16 rad a frame, and only the nose, 0.1 m off its axis, shows it: of
    # 1.2 m · 0.02 a rad it stays (0.024 / 0.1)² = 6 % behind, 0.01 rad.
    np.testing.assert_allclose(clip.joint_positions, MOTION.joint_positions, atol=0.02)
    assert [(one.name, one.body) for one in found.key_points] == [(n, p.body) for n, p in MAPPING.items()]
    assert all(one.num_seen == 8 and (one.mean_distance or 0) < 1e-3 for one in found.key_points)
    told = [sentence for sentence in found.warnings[0] if "millimetres" in sentence]
    assert len(told) == (layout == "dannce")  # 1,000 times as large; NWB says what its unit is


def test_shifted_points_are_found_and_a_smaller_animal_is_told(model: mujoco.MjModel, tmp_path: Path) -> None:
    npz(tmp_path / "sent", key_points=0.9 * seen(model), names=np.array(NAMES), rate=15.0)
    shifted = {**POINTS, "chest": {"body": "torso", "offset": [0.1, 0.13, 0.2]}}  # it is at y = 0.05
    found = found_in(tmp_path / "sent", model, {"points": shifted, "scale": 1 / 0.9, "fit_offsets": 4})
    chest = next(one for one in found.key_points if one.name == "chest")
    # A tenth of the weight draws it to 0.13, so it comes to 0.05 + 0.08 · 0.1 / 1.1 = 0.057 at best; the
    # torso, which has three points, turns towards it and leaves half of the way.
    assert 0.057 < chest.offset[1] < 0.1
    assert (chest.mean_distance or 1) < 0.01  # of 0.08
    unscaled = found_in(tmp_path / "sent", model, {"points": POINTS, "fit_offsets": 0, "lift": 0.096})
    # 1 / 0.9 = 1.11, of which the pose takes a part.
    assert any("times as far apart as the key points: a `scale` of 1." in one for one in unscaled.warnings[0])


def test_the_rat_needs_no_mapping_where_names_and_body_are_its(model: mujoco.MjModel) -> None:
    rodent = key_points._rodent()
    bodies = "".join(f'<body name="{name}"/>' for name in sorted({point.body for point in rodent.values()}))
    rat = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    names = [*rodent, "TailTip"]
    assert key_points._ready(names, 24, rat) is rodent
    assert key_points._ready(None, 23, rat) is rodent
    for other in ((names[1:], 23, rat), (None, 24, rat), (names, 24, model)):
        with pytest.raises(BadClips, match="does not say which points of the body they are"):
            key_points._ready(*other)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"points": {**POINTS, "wing": {"body": "head"}}}, "The recording has no key points `wing`"),
        ({"points": {**POINTS, "tail": {"body": "wing"}}}, "The model has no body `wing`"),
        (
            {"points": dict([*POINTS.items()][:2])},
            "In frame 0, 2 of the mapped key points are seen; it takes 3",
        ),
        ({"points": POINTS, "scale": 0.001}, r"are 0.00\d+ times as far apart as the body's: give `scale`"),
        ({"points": POINTS, "lift": 1e39}, "`points.json` at `lift`"),
        ({"points": POINTS, "names": NAMES[:4]}, "The file has 11 key points and 4 names"),
        ({"points": POINTS, "names": [*NAMES[:-1], "hip"]}, "Two key points are called 'hip'"),
        ({"points": {"hip": {"body": "head", "at": [0, 0, 0]}}}, r"`points.json` at `points.hip.at`"),
        ({}, "does not say which points of the body they are"),
    ],
)
def test_what_does_not_fit_the_recording_is_refused(
    options: dict[str, Any], sentence: str, model: mujoco.MjModel, tmp_path: Path
) -> None:
    npz(tmp_path / "sent", key_points=seen(model), names=np.array(NAMES))
    with pytest.raises(BadClips, match=sentence):
        found_in(tmp_path / "sent", model, options)


def test_what_is_no_recording_is_refused(model: mujoco.MjModel, tmp_path: Path) -> None:
    path = tmp_path / "sent"
    for arrays, sentence in (
        ({"tracks": np.zeros((8, 2, 11, 3))}, r"the shape \[8, 2, 11, 3\] of 2 animals"),
        ({"pred": np.zeros((8, 11, 2))}, r"`pred` has the shape \[8, 11, 2\]"),
        (
            {"key_points": np.full((8, 11, 3), np.nan), "names": np.array(NAMES)},
            "In frame 0, 0 of the mapped",
        ),
        ({"tracks": np.zeros((1, 2, 11, 8))}, "two coordinates are no place in space"),
        ({"key_points": np.zeros((8, 3, 3))}, r"the shape \[8, 3, 3\], which may be \[T, K, 3\] or"),
        ({"key_points": np.zeros((8, 0, 3)), "names": np.array([], "U1")}, "has no key points"),
        ({"key_points": np.zeros((8, 3, 4)), "names": np.array(NAMES)}, "4 key points, and `names` 11 names"),
        ({"key_points": np.zeros((8, 1, 3)), "names": np.array(["a\0b"])}, "has the character U"),
        ({"key_points": np.zeros((8, 1, 3)), "names": np.array(["a\ud800"])}, "that UTF-8 cannot encode"),
        *(
            ({"key_points": np.zeros((8, 1, 3)), "fps": fps}, "frames a second: it must be more than 0")
            for fps in (0.0, -5.0, np.nan, np.inf)
        ),
        (
            {"joint_pos": np.zeros((8, 14)), "fps": 15},
            "is for key points, and the file beside it is of mjlab",
        ),
    ):
        npz(path, **arrays)
        with pytest.raises(BadClips, match=sentence):
            found_in(path, model)
    npz(path, key_points=seen(model), names=np.array(NAMES))
    with pytest.raises(BadClips, match="give `rate`"):
        read(sent(path), model)
    path.write_text("a_x,a_y,a_z,b_x,b_y,b_z,c_x,c_y,c_z,a_x\n" + "0," * 9 + "0\n")
    with pytest.raises(BadClips, match="the column 'a_x' twice"):
        found_in(path, model)
    with pytest.raises(BadClips, match="no JSON: it has 'hip' twice"):
        key_points.options_of(b'{"points": {"hip": {"body": "a"}, "hip": {"body": "b"}}}')
    with pytest.raises(BadClips, match=r"The name 'a\\x00' has the character"):
        key_points.options_of(b'{"points": {"hip": {"body": "a\\u0000"}}}')
    nwb(path, seen(model), times=np.zeros(MOTION.num_frames))
    with pytest.raises(BadClips, match="`timestamps` of the NWB file do not rise"):
        found_in(path, model)


def test_points_that_are_infinite_are_not_seen_and_those_that_are_far_off_are_refused(
    model: mujoco.MjModel, tmp_path: Path
) -> None:
    points, options = seen(model), {"points": POINTS, "fit_offsets": 0}
    points[3, 0, 1] = np.inf
    npz(tmp_path / "sent", key_points=points, names=np.array(NAMES))
    found = read(sent(tmp_path / "sent", options), model, rate=2.0)
    assert found.key_points[0].num_seen == MOTION.num_frames - 1
    assert any("has 2 frames a second, which are few" in told for told in found.warnings[0])
    points[3, 0] = 1e200
    npz(tmp_path / "sent", key_points=points, names=np.array(NAMES))
    with pytest.raises(BadClips, match=r"1e\+200 m from the origin; at most 1,000 m"):
        found_in(tmp_path / "sent", model, options)


def test_the_name_of_an_array_tells_the_axes_of_three_points() -> None:
    array = np.arange(18.0).reshape(2, 3, 3)
    found = key_points_of.of_arrays({"pred": array})
    assert found is not None
    np.testing.assert_array_equal(found.points, array.transpose(0, 2, 1))


def test_a_zip_is_one_recording_with_its_points(model: mujoco.MjModel, tmp_path: Path) -> None:
    npz(tmp_path / "sent", key_points=seen(model), names=np.array(NAMES))
    packed = sent(tmp_path / "sent")
    with zipfile.ZipFile(packed, "a") as file:
        file.writestr("a folder/.DS_Store", "a Mac's")
    recording, options = key_points.unpacked(packed)
    assert recording.read_bytes() == (tmp_path / "sent").read_bytes()
    assert options == key_points.options_of(json.dumps({"points": POINTS}).encode())
    with zipfile.ZipFile(packed, "a") as file:
        file.writestr("another/points.json", "{}")
    with pytest.raises(BadClips, match="has 2 such and 1 other files"):
        key_points.unpacked(packed)
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_LZMA) as file:
        file.writestr("é/points.json", json.dumps({"points": POINTS}))
        file.write(tmp_path / "sent", "recording")
    whole = packed.read_bytes()
    # First the header of its first file is damaged, then that file's name in the list at the end.
    for damaged in (
        whole[:70] + b"\xff" * 40 + whole[110:],
        whole[::-1].replace(b"\xa9\xc3", b"\xff\xff", 1)[::-1],
    ):
        packed.write_bytes(damaged)
        with pytest.raises(BadClips, match="The ZIP is not whole"):
            key_points.unpacked(packed)


def test_columns_that_are_joints_are_no_key_points(tmp_path: Path) -> None:
    path = tmp_path / "sent"
    path.write_text("a_x,a_y,a_z,b_x,b_y,b_z,c_x,c_y,c_z\n" + "0," * 8 + "0\n")
    assert key_points_of.of_text(path) is not None
    assert key_points_of.of_text(path, ["b_y"]) is None
    # Of 400 MB, its cells took a minute.
    path.write_text("0," * 600_000)
    assert key_points_of.of_text(path) is None
    with pytest.raises(BadClips, match="Line 1 of the file has more than 20,000 characters"):
        lafan.recordings(path)


@pytest.mark.parametrize(
    ("num_points", "rounds", "most"),
    # 500 s / (5 ms + 0.05 ms a point + 0.0012 ms · 13² degrees of freedom). A round of offsets takes five
    # frames for each of the 100 that they are fitted to.
    [(23, 2, 77_705), (3, 0, 93_409), (3, 20, 83_409)],
)
def test_a_recording_has_a_budget_of_frames(
    num_points: int, rounds: int, most: int, model: mujoco.MjModel
) -> None:
    options = key_points.KeyPointOptions(fit_offsets=rounds)
    frames = np.zeros((most + 10, num_points, 3))
    assert key_points.seconds_for(KeyPoints(frames[:most]), options, model) == 500
    with pytest.raises(BadClips, match=f"{most:,} are solved at most"):
        key_points.seconds_for(KeyPoints(np.zeros((most + 100, num_points, 3))), options, model)
