"""Numbers as artifacts, and their pictures, which a separate process draws in the meantime."""

import io
import os
import subprocess
import sys
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.environments import trajectory
from core.environments.trajectory import Trajectory
from core.installation import to_install
from core.rendering.gl import last_line
from worker.host.child import collect, kill, launch
from worker.protocol import Noted
from worker.training.event_writer import EventWriter

_PLOTTING = (sys.executable, "-m", "worker.render.plotting")
# On its first run on a machine matplotlib reads all fonts; it may also have to wait for a core.
_TIMEOUT_S = 60.0
_NO_MATPLOTLIB = f"This worker has no matplotlib ({to_install('plots')}): there are no pictures of numbers."


@contextmanager
def kept_with_path(
    events: EventWriter, shown: Trajectory, suffix: str, step: int | None, title: str
) -> Generator[None]:
    """Keep a trajectory; and, when the block is over, the picture of its path that was drawn meanwhile."""
    numbers, picture = f"trajectory{suffix}.npz", f"path{suffix}.png"
    trajectory.save(events.spool / numbers, shown)
    # The supervisor removes the file that it is handed, so the drawing process reads it by a second name.
    own = events.spool / f".{numbers}"
    os.link(events.spool / numbers, own)
    events.hand_over(numbers, "trajectory", "application/x-npz", step=step)
    try:
        with _drawing(events, ["path", str(own), str(events.spool / picture), title]):
            yield
    finally:
        own.unlink()
    if (events.spool / picture).exists():
        facts = {"episodes": len(shown.episodes)}
        events.hand_over(picture, "picture", "image/png", step=step, metadata=facts)


@contextmanager
def kept_with_tables(
    events: EventWriter, tables: Mapping[str, NDArray[Any]], step: int, title: str
) -> Generator[None]:
    """Keep a run's tables as `tables.npz`; and, when the block is over, their pictures."""
    archive = io.BytesIO()
    np.savez_compressed(archive, allow_pickle=False, **dict(tables))
    own = events.spool / ".shown-tables.npz"
    own.write_bytes(archive.getvalue())
    events.keep("tables.npz", archive.getvalue(), "tables", "application/x-npz", step=step)
    try:
        with _drawing(events, ["tables", str(own), str(events.spool), title]) as drawn:
            yield
    finally:
        own.unlink()
    for name in drawn:
        events.hand_over(name, "picture", "image/png", step=step)


@contextmanager
def _drawing(events: EventWriter, arguments: Sequence[str]) -> Generator[list[str]]:
    """Runs the process beside the block; then the list holds the words it printed. A failure is a note."""
    notes: list[str] = []
    if find_spec("matplotlib") is None:
        events.send(Noted(text=_NO_MATPLOTLIB))
        yield notes
        return
    with launch(
        [*_PLOTTING, *arguments],
        os.environ,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        in_own_session=False,
    ) as process:
        try:
            yield notes
            words, errors = collect(process, _TIMEOUT_S)
        except subprocess.TimeoutExpired:
            words, errors = "", f"it was not ready within {_TIMEOUT_S:g} s"
        finally:
            kill(process)
    notes += words.split()
    if process.returncode != 0:
        events.send(Noted(text=f"There is no picture of the {arguments[0]}: {last_line(errors)}"))
