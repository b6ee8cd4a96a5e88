"""CSV as Unitree published LAFAN1, retargeted to its robots: a line is a frame, without a header."""

from pathlib import Path

import numpy as np

from core.clips.formats.recording import MOST_NUMBERS, Recording
from core.errors import BadClips

NAME = "lafan"
_ROOT = 7
_LONGEST_LINE = 20_000


def recordings(path: Path) -> list[Recording]:
    """The file's one clip: the root's position, its orientation x y z w, and a column a joint.

    A first line without numbers is a header, whose names behind the root's seven are the joints'. Raises
    BadClips with the line.
    """
    try:
        text = path.read_text("utf-8-sig")
    except UnicodeDecodeError:
        raise BadClips("The file is neither NPZ nor HDF5, nor text of numbers (CSV).") from None
    lines = [line for line in enumerate(text.splitlines(), 1) if line[1].strip()]
    if long := [number for number, text in lines[:2] if len(text) > _LONGEST_LINE]:
        raise BadClips(f"Line {long[0]} of the file has more than {_LONGEST_LINE:,} characters.")
    header: list[str] | None = None
    if lines and not _is_numeric(lines[0][1]):
        header = [name.strip().strip('"') for name in lines.pop(0)[1].split(",")]
    if not lines:
        raise BadClips("The file has no line of numbers.")
    width = len(lines[0][1].split(","))
    if header is not None and len(header) != width:
        raise BadClips(f"The header has {len(header)} names, but line {lines[0][0]} has {width} numbers.")
    if len(lines) * width > MOST_NUMBERS:
        raise BadClips(f"The file has {len(lines):,} lines: at most {MOST_NUMBERS:,} numbers are read.")
    values = np.array([_row(line, number, width) for number, line in lines]).reshape(-1, width)
    if width < _ROOT + 1:
        raise BadClips(
            f"A line has {width} numbers. It needs the root's position, orientation x y z w, and joints."
        )
    return [
        Recording(
            name="",
            joint_positions=values[:, _ROOT:],
            root_position=values[:, :3],
            root_orientation=values[:, [6, 3, 4, 5]],
            joints=None if header is None else tuple(header[_ROOT:]),
            rate_hint="Unitree's LAFAN1 has 30.",
        )
    ]


def _is_numeric(line: str) -> bool:
    try:
        float(line.split(",")[0])
    except ValueError:
        return False
    return True


def _row(line: str, number: int, width: int) -> list[float]:
    try:
        row = [float(value) for value in line[:_LONGEST_LINE].split(",")]
    except ValueError:
        raise BadClips(
            f"Line {number} of the file is not numbers with commas between: {line[:40]!r}."
        ) from None
    if len(row) != width:
        raise BadClips(f"Line {number} has {len(row)} numbers, the first one {width}.")
    return row
