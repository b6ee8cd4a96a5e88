"""Files of key points in three dimensions: HDF5 of SLEAP and stac-mjx, NWB, MATLAB of DANNCE, NPZ, and CSV of
Anipose and DeepLabCut."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io  # pyright: ignore[reportMissingTypeStubs]

from core.clips.formats import hdf5
from core.clips.formats.recording import LONGEST_NAME, MOST_NUMBERS, number, numbers, strings
from core.clips.quaternions import Array
from core.errors import BadClips

NAME = "key points"
# How files of MATLAB begin: up to version 7, and from 7.3 on, which are HDF5.
MATLAB, MATLAB_HDF5 = b"MATLAB 5", b"MATLAB 7.3"
# What the arrays are called, in the order in which they are looked for.
_POINTS = ("key_points", "keypoints", "tracks", "pred", "points3d")
_NAMES = ("names", "kp_names", "node_names", "keypoint_names")
_RATES = ("rate", "fps")
# Fewer triples of columns `NAME_x`, `NAME_y`, `NAME_z` may be there by chance: the CSV is of another kind.
_FEWEST_NAMED = 3


@dataclass(frozen=True, eq=False)
class KeyPoints:
    """points: [T, K, 3] in the file's unit of length, NaN where a key point was not seen. names: of the K key
    points; None: the file has none. rate: frames per second; None: the file does not say."""

    points: Array
    names: tuple[str, ...] | None = None
    rate: float | None = None


def of_arrays(file: Mapping[str, Any], *, is_matlabs: bool = False) -> KeyPoints | None:
    """The key points among a file's arrays, by their names; None: no array has such a name. Raises BadClips.

    The array is [T, K, 3] or [T, 3, K], or with an axis for the one animal [T, 1, K, 3] or [T, 1, 3, K].
    is_matlabs: the file is MATLAB's HDF5, which has the axes in the opposite order.
    """
    found = next((name for name in _POINTS if name in file), None)
    if found is None:
        return None
    values = numbers(_values(file[found], found), found, (3, 4))
    values = values.T if is_matlabs else values
    if values.ndim == 4:
        if values.shape[1] != 1:
            raise BadClips(f"`{found}` has {values.shape[1]} animals: send a file of one.")
        values = values[:, 0]
    if values.shape[2] != 3 and values.shape[1] == 3:
        values = values.transpose(0, 2, 1)
    if values.shape[2] != 3:
        raise BadClips(f"`{found}` has the shape {list(values.shape)}, not [T, K, 3].")
    names = next((strings(_values(file[name], name), name) for name in _NAMES if name in file), None)
    rate = next((number(_values(file[name], name), name) for name in _RATES if name in file), None)
    return KeyPoints(values, names, rate)


def of_matlab(path: Path) -> KeyPoints | None:
    """The key points of a MATLAB file up to version 7; None: it has none. Raises BadClips."""
    try:
        return of_arrays(scipy.io.loadmat(path, variable_names=(*_POINTS, *_RATES)))
    except BadClips:
        raise
    except Exception as error:  # SciPy raises anything for damage.
        raise BadClips(f"The MATLAB file is damaged: {error}.") from None


def of_nwb(file: Mapping[str, Any]) -> KeyPoints | None:
    """The key points of an NWB file: those of its `PoseEstimation` (ndx-pose), in a module of `processing`.

    Each series of it is a key point, with the places [T, 3] `data` times `conversion`. None: the file has no
    `PoseEstimation`. Raises BadClips, also where it has several.
    """
    modules = hdf5.members(file["processing"]).values() if "processing" in file else ()
    groups = [
        hdf5.members(group)
        for module in modules
        for group in hdf5.members(module).values()
        if _text(group.attrs.get("neurodata_type")) == "PoseEstimation"
    ]
    if not groups:
        return None
    if len(groups) > 1:
        raise BadClips(f"The NWB file has {len(groups)} `PoseEstimation`: send a file of one.")
    groups = {name: hdf5.members(part) for name, part in groups[0].items() if not hdf5.is_array(part)}
    series = {name: members for name, members in groups.items() if "data" in members}
    columns = [_of_series(name, members["data"]) for name, members in series.items()]
    if not columns or len({len(column) for column in columns}) > 1:
        raise BadClips("The series of `PoseEstimation` do not all have the same number of frames.")
    rate = next((rate for members in series.values() if (rate := _rate(members)) is not None), None)
    return KeyPoints(np.stack(columns, axis=1), tuple(name[:LONGEST_NAME] for name in series), rate)


def of_text(path: Path) -> KeyPoints | None:
    """The key points of a CSV file: its header has `NAME_x`, `NAME_y`, `NAME_z`, or DeepLabCut's lines
    `bodyparts` and `coords`.

    Other columns are not read. None: the file is of another kind. Raises BadClips, which names the line.
    """
    try:
        text = path.read_text("utf-8-sig")
    except UnicodeDecodeError:
        return None
    rows = [(number, line.split(",")) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not rows:
        return None
    header, rows = _header(rows)
    places = {name.removesuffix("_x"): place for place, name in enumerate(header) if name.endswith("_x")}
    found = {
        name: [place, *(header.index(f"{name}_{axis}") for axis in "yz")]
        for name, place in places.items()
        if f"{name}_y" in header and f"{name}_z" in header
    }
    if len(found) < _FEWEST_NAMED:
        return None
    if twice := [name for name in header if name[-2:] in ("_x", "_y", "_z") and header.count(name) > 1]:
        raise BadClips(f"The header has the column {twice[0]!r} twice.")
    if len(rows) * len(found) * 3 > MOST_NUMBERS:
        raise BadClips(f"The file has {len(rows):,} lines: at most {MOST_NUMBERS:,} numbers are read.")
    columns = [place for places in found.values() for place in places]
    points = np.array([_row(row, columns, line) for line, row in rows]).reshape(-1, len(found), 3)
    return KeyPoints(points, tuple(name[:LONGEST_NAME] for name in found))


def _header(rows: list[tuple[int, list[str]]]) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """The columns' names, `NAME_x` and so on, and the lines after the header. rows: (line number, cells)."""
    first = {row[0]: [cell.strip().strip('"') for cell in row] for _, row in rows[:4]}
    if "bodyparts" in first and "coords" in first:
        ends = next(place for place, (_, row) in enumerate(rows) if row[0] == "coords")
        pairs = zip(first["bodyparts"], first["coords"], strict=False)
        return [f"{part}_{axis}" for part, axis in pairs], rows[ends + 1 :]
    return [cell.strip().strip('"') for cell in rows[0][1]], rows[1:]


def _row(row: Sequence[str], columns: Sequence[int], line: int) -> list[float]:
    try:
        return [float(row[place].strip() or "nan") for place in columns]
    except (ValueError, IndexError):
        raise BadClips(f"Line {line} lacks a number in a column of key points.") from None


def _values(member: Any, name: str) -> Any:
    return member if isinstance(member, np.ndarray) else hdf5.read(member, name)


def _of_series(name: str, member: Any) -> Array:
    values = numbers(hdf5.read(member, name), name)
    if values.shape[1] != 3:
        raise BadClips(f"`{name}` has {values.shape[1]} coordinates; key points in space have 3.")
    return values * number(member.attrs.get("conversion", 1.0), "conversion")


def _rate(series: Mapping[str, Any]) -> float | None:
    if "starting_time" in series and "rate" in series["starting_time"].attrs:
        return number(series["starting_time"].attrs["rate"], "rate")
    if "timestamps" not in series:
        return None
    times = numbers(hdf5.read(series["timestamps"], "timestamps"), "timestamps", (1,))
    return None if len(times) < 2 else round(float(1 / np.median(np.diff(times))), 3)


def _text(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
