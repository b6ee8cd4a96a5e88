"""Where a body went, seen from above."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.rendering.plots.style import COLOURS, new_figure, plain

Floats = NDArray[np.floating[Any]]

# If there are more paths than colours, some share one and differ only by where they end.
_MAX_COLOURED = len(COLOURS)
# A path on a thousand pixels cannot show more points.
_MAX_POINTS = 2000


@dataclass(frozen=True)
class Walk:
    """One episode: time [T] in seconds, position [T, 2 or more] in metres, and a target like it, if any.

    terminated: whether the environment ended it; otherwise it was truncated.
    """

    time: Floats
    position: Floats
    terminated: bool = False
    target: Floats | None = None


def path_from_above(walks: Sequence[Walk], *, title: str = "") -> Any:
    """A figure of x and y in metres, at one scale: one line per episode, from its ring to its mark.

    A single episode is coloured by time, several by their number.
    """
    figure = new_figure(4.8, title)
    axes = figure.subplots()
    plain(axes)
    if len(walks) == 1:
        _by_time(figure, axes, walks[0])
    else:
        for number, walk in enumerate(walks):
            _in_one_colour(axes, walk, number, len(walks))
    for walk in walks:
        _mark(axes, walk, small=len(walks) > _MAX_COLOURED)
    _explain(axes, walks)
    axes.set_xlabel("x in m")
    axes.set_ylabel("y in m")
    _widen(axes, walks)
    axes.margins(0.08)
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="datalim")
    return figure


def _by_time(figure: Any, axes: Any, walk: Walk) -> None:
    from matplotlib.collections import LineCollection

    x, y, time = _thinned(walk)
    points = np.stack([x, y], axis=-1)
    lines = LineCollection(
        list(np.stack([points[:-1], points[1:]], axis=1)), cmap="viridis_r", linewidths=2.4, capstyle="round"
    )
    lines.set_array((time[:-1] + time[1:]) / 2)
    lines.set_clim(float(time[0]), float(time[-1]) or 1.0)
    axes.add_collection(lines)
    axes.autoscale_view()
    figure.colorbar(lines, ax=axes, label="time in s", pad=0.02, fraction=0.05)


def _in_one_colour(axes: Any, walk: Walk, number: int, count: int) -> None:
    x, y, _ = _thinned(walk)
    if count <= _MAX_COLOURED:
        axes.plot(x, y, color=COLOURS[number], linewidth=1.8, label=f"episode {number}")
    else:
        axes.plot(x, y, color=COLOURS[0], linewidth=1.0, alpha=max(0.15, min(0.6, 20 / count)))


def _mark(axes: Any, walk: Walk, *, small: bool) -> None:
    """Draw start, end and any targets above all lines."""
    size = 0.55 if small else 1.0
    over: dict[str, Any] = {"linestyle": "none", "zorder": 4, "clip_on": False}
    if walk.target is not None:
        places = np.unique(np.asarray(walk.target)[:, :2], axis=0)
        axes.plot(*places.T, marker="*", markersize=15 * size, color="#f0b000", mec="black", mew=0.8, **over)
    axes.plot(*walk.position[0, :2], marker="o", markersize=8 * size, mfc="white", mec="black", **over)
    end: dict[str, Any] = (
        {"marker": "X", "color": "#d55e00"} if walk.terminated else {"marker": "s", "color": "black"}
    )
    axes.plot(*walk.position[-1, :2], markersize=8 * size, mec="white", mew=0.7, **end, **over)


def _explain(axes: Any, walks: Sequence[Walk]) -> None:
    from matplotlib.lines import Line2D

    def mark(label: str, **style: Any) -> Any:
        all_of_it: dict[str, Any] = {"linestyle": "none", "markersize": 7, **style}
        return Line2D([], [], label=label, **all_of_it)

    marks = [mark("start", marker="o", mfc="white", mec="black")]
    if not all(walk.terminated for walk in walks):
        marks.append(mark("end: cut off", marker="s", color="black", mec="white"))
    if any(walk.terminated for walk in walks):
        marks.append(mark("end: by the environment", marker="X", color="#d55e00", mec="white"))
    if any(walk.target is not None for walk in walks):
        marks.append(mark("target", marker="*", color="#f0b000", mec="black", markersize=11))
    if 1 < len(walks) <= _MAX_COLOURED:
        marks += axes.get_legend_handles_labels()[0]
    elif len(walks) > 1:
        marks.append(Line2D([], [], color=COLOURS[0], label=f"{len(walks)} episodes"))
    axes.figure.legend(
        handles=marks, loc="outside lower center", ncols=4, frameon=False, fontsize=9, handlelength=1.4
    )


def _widen(axes: Any, walks: Sequence[Walk]) -> None:
    """Show at least 10 cm, so that a body that stays in place does not seem to travel."""
    places = np.concatenate([walk.position[:, :2] for walk in walks])
    low, high = places.min(axis=0), places.max(axis=0)
    centre, half = (low + high) / 2, max(0.05, float((high - low).max()) / 2)
    axes.update_datalim([centre - half, centre + half])


def _thinned(walk: Walk) -> tuple[Floats, Floats, Floats]:
    """x, y and time at no more than `_MAX_POINTS` moments, the last one among them."""
    length = len(walk.time)
    kept = np.unique(np.linspace(0, length - 1, min(length, _MAX_POINTS)).round().astype(int))
    return walk.position[kept, 0], walk.position[kept, 1], walk.time[kept]
