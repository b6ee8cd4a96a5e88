"""Files of key points in three dimensions: HDF5 of SLEAP and stac-mjx, NWB, MATLAB of DANNCE, NPZ, and CSV of
Anipose and DeepLabCut."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from core.clips.formats import hdf5
from core.clips.formats.recording import LONGEST_NAME, MOST_NUMBERS, check_text, number, numbers, strings
from core.clips.quaternions import Array
from core.errors import BadClips

NAME = "key points"
# How files of MATLAB begin: up to version 7, and from 7.3 on, which are HDF5.
MATLAB, MATLAB_HDF5 = b"MATLAB 5", b"MATLAB 7.3"
# Names of the arrays: of each line, the first one that a file has is read.
_POINTS = ("key_points", "keypoints", "tracks", "pred", "points3d")
_NAMES = ("names", "kp_names", "node_names", "keypoint_names")
_RATES = ("rate", "fps")
# The one that DANNCE writes, always [T, 3, K].
_DANNCE = "pred"
# Fewer triples of columns `NAME_x`, `NAME_y`, `NAME_z` may be there by chance: the CSV is of another kind.
_FEWEST_NAMED = 3
# Lines that a header takes at most: DeepLabCut's. Longer ones are not split, which takes a minute for some.
_MOST_HEADER_LINES, _LONGEST_LINE = 4, 2**20


@dataclass(frozen=True, eq=False)
class KeyPoints:
    """points: [T, K, 3] in the file's unit of length, NaN where a key point was not seen. names: of the K key
    points; None: the file has none. rate: frames per second; None: the file does not say.

    Raises BadClips for no key points, and for names that no record can hold.
    """

    points: Array
    names: tuple[str, ...] | None = None
    rate: float | None = None

    def __post_init__(self) -> None:
        if not self.points.shape[1]:
            raise BadClips("The file has no key points.")
        for name in self.names or ():
            check_text(name)
        self.points[~np.isfinite(self.points).all(axis=-1)] = np.nan


def of_arrays(file: Mapping[str, Any], *, is_matlabs: bool = False) -> KeyPoints | None:
    """The key points among a file's arrays, by their names; None: no array has such a name. Raises BadClips.

    is_matlabs: the file is MATLAB's HDF5, which has the axes in the opposite order, and texts as references.
    """
    found = next((name for name in _POINTS if name in file), None)
    if found is None:
        return None
    values = numbers(_values(file[found], found), found, (3, 4))
    points = _points(values.T if is_matlabs else values, found)
    names = None if is_matlabs else _names_in(file, points.shape[1])
    rate = next((number(_values(file[name], name), name) for name in _RATES if name in file), None)
    return KeyPoints(points, names, rate)


def _points(values: Array, name: str) -> Array:
    """The points [T, K, 3] of an array that is [T, K, 3], [T, 3, K], SLEAP's [1, 3, K, T], or of one animal
    [T, 1, K, 3] or [T, 1, 3, K]. Raises BadClips."""
    shape = list(values.shape)
    if values.ndim == 4 and shape[0] == 1 and shape[1] in (2, 3):
        if shape[1] == 2:
            raise BadClips(f"`{name}` has the shape {shape}: two coordinates are no place in space.")
        return values[0].transpose(2, 1, 0)
    if values.ndim == 4:
        if shape[1] != 1:
            raise BadClips(f"`{name}` has the shape {shape} of {shape[1]} animals: send a file of one.")
        values = values[:, 0]
    if values.shape[1:] == (3, 3) and name != _DANNCE:
        raise BadClips(f"`{name}` has the shape {shape}, which may be [T, K, 3] or [T, 3, K]: send CSV.")
    if values.shape[1] == 3 and (values.shape[2] != 3 or name == _DANNCE):
        values = values.transpose(0, 2, 1)
    if values.shape[2] != 3:
        raise BadClips(f"`{name}` has the shape {shape}, not [T, K, 3].")
    return values


def _names_in(file: Mapping[str, Any], number: int) -> tuple[str, ...] | None:
    """The names of so many key points; None: the file has none. Raises BadClips, before it reads more names
    than there are key points."""
    name = next((name for name in _NAMES if name in file), None)
    if name is None:
        return None
    member = file[name]
    if (has := getattr(member, "size", None)) is not None and has > number:
        raise BadClips(f"The file has {number:,} key points, and `{name}` {has:,} names.")
    return strings(_values(member, name), name)


def of_matlab(path: Path) -> KeyPoints | None:
    """The key points of a MATLAB file up to version 7; None: it has none. Raises BadClips."""
    # Only these files need it, and it takes half a second to load.
    import scipy.io  # pyright: ignore[reportMissingTypeStubs]

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


def of_text(path: Path, joints: Collection[str] = ()) -> KeyPoints | None:
    """The key points of a CSV file: its header has `NAME_x`, `NAME_y`, `NAME_z`, or DeepLabCut's lines
    `bodyparts` and `coords`.

    Other columns are not read. joints: columns of these names are no key points. None: the file is of another
    kind. Raises BadClips, which names the line.
    """
    try:
        with path.open(encoding="utf-8-sig") as file:
            return _of_lines(file, joints)
    except UnicodeDecodeError:
        return None


def _of_lines(file: TextIO, joints: Collection[str]) -> KeyPoints | None:
    rows = ((number, text) for number, text in enumerate(file, 1) if text.strip())
    first = list(islice(rows, _MOST_HEADER_LINES))
    if not first or any(len(text) > _LONGEST_LINE for _, text in first):
        return None
    columns, num_header_lines = _header([text.split(",") for _, text in first])
    places = {name: place for place, name in enumerate(columns)}
    found = {
        name: [places[f"{name}_{axis}"] for axis in "xyz"]
        for name in (column.removesuffix("_x") for column in columns if column.endswith("_x"))
        if f"{name}_y" in places and f"{name}_z" in places
    }
    if len(found) < _FEWEST_NAMED or any(f"{name}_{axis}" in joints for name in found for axis in "xyz"):
        return None
    of_points = [place for places in found.values() for place in places]
    if len(set(columns)) < len(columns):
        for name, number in Counter(columns).items():
            if number > 1 and places[name] in of_points:
                raise BadClips(f"The header has the column {name!r} twice.")
    read: list[Array] = []
    for line, text in chain(first[num_header_lines:], rows):
        if len(text) > _LONGEST_LINE or len(read) * len(of_points) > MOST_NUMBERS:
            raise BadClips(f"Line {line} is too long, or behind the {MOST_NUMBERS:,} numbers that are read.")
        read.append(np.array(_row(text.split(","), of_points, line)))
    points = np.array(read).reshape(-1, len(found), 3)
    return KeyPoints(points, tuple(name[:LONGEST_NAME] for name in found))


def _header(rows: Sequence[Sequence[str]]) -> tuple[list[str], int]:
    """The columns' names, `NAME_x` and so on, and how many of the rows they take. rows: the first ones."""
    first = {row[0]: [cell.strip().strip('"') for cell in row] for row in rows}
    if "bodyparts" in first and "coords" in first:
        pairs = zip(first["bodyparts"], first["coords"], strict=False)
        return [f"{part}_{axis}" for part, axis in pairs], [row[0] for row in rows].index("coords") + 1
    return [cell.strip().strip('"') for cell in rows[0]], 1


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
    if len(times) < 2:
        return None
    step = float(np.median(np.diff(times)))
    if not step > 0:
        raise BadClips("The `timestamps` of the NWB file do not rise.")
    return round(1 / step, 3)


def _text(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
