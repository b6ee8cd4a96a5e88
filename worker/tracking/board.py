"""Event files for TensorBoard."""

import json
import math
import os
import tempfile
from array import array
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

from tensorboardX import SummaryWriter


def lines_by_step(path: Path) -> Iterator[bytes]:
    """Among equal steps, the earlier line comes first."""
    steps, places = array("q"), array("q")
    with path.open("rb") as file:
        place = 0
        for line in file:
            steps.append(json.loads(line)["step"])
            places.append(place)
            place += len(line)
        for number in sorted(range(len(steps)), key=steps.__getitem__):
            file.seek(places[number])
            yield file.readline()


def write_events(measurements: Path, path: Path) -> None:
    """Every finite value of the JSON lines as a scalar of its step and time, in the order of the steps.

    In that order, because TensorBoard takes a lower step for a restart and drops what came before.
    """
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        with SummaryWriter(folder) as writer:
            for row in map(json.loads, lines_by_step(measurements)):
                time = datetime.fromisoformat(row["time"]).timestamp()
                for name, value in row["values"].items():
                    if value is not None and math.isfinite(value):
                        writer.add_scalar(name, value, row["step"], time)  # pyright: ignore[reportUnknownMemberType]
        (written,) = Path(folder).iterdir()
        os.replace(written, path)
