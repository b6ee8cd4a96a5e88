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
import scipy.io

from core.clips import key_points
from core.clips.formats.key_points import KeyPoints
from core.clips.reading import Reading, read
from core.errors import BadClips
from tests.unit.clips.bodies import walker
from tests.unit.clips.test_inverse_kinematics import MAPPING, MOTION, NAMES, seen

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


def nwb(path: Path, points: Any) -> None:
    """As pynwb with ndx-pose writes it, in millimetres."""
    with h5py.File(path, "w") as file:
        group = file.create_group("processing/behavior/PoseEstimation")
        group.attrs["neurodata_type"] = "PoseEstimation"
        for place, name in enumerate(NAMES):
            series = group.create_group(name)
            series["data"] = points[:, place] * 1000
            series["data"].attrs["conversion"] = 0.001
            series["timestamps"] = 7.0 + np.arange(len(points)) / 15


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
    scipy.io.savemat(path, {"pred": points.transpose(0, 2, 1) * 1000, "sampleID": np.arange(len(points))})


def dannce_of_matlab(path: Path, points: Any) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        file["pred"] = points.transpose(0, 2, 1).T  # MATLAB's axes are the other way round.
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")


LAYOUTS: dict[str, Callable[[Path, Any], None]] = {
    "npz": lambda path, points: npz(path, key_points=points, names=np.array(NAMES), fps=15.0),
    "sleap": lambda path, points: hdf5(path, tracks=points[:, None], node_names=np.array(NAMES, "S")),
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
        ({"tracks": np.zeros((8, 2, 11, 3))}, "`tracks` has 2 animals"),
        ({"pred": np.zeros((8, 11, 2))}, r"`pred` has the shape \[8, 11, 2\]"),
        (
            {"key_points": np.full((8, 11, 3), np.nan), "names": np.array(NAMES)},
            "In frame 0, 0 of the mapped",
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
    with pytest.raises(BadClips, match=r"50,000 frames of 23 key points; .* are 43,478 frames"):
        key_points.seconds_for(KeyPoints(np.zeros((50_000, 23, 3))))
