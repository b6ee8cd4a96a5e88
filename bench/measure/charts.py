"""The pictures of docs/performance.md. matplotlib (extra `plots`) is loaded only when one is drawn."""

from collections.abc import Iterable
from itertools import cycle
from pathlib import Path
from typing import Any

from bench.measure.result import Bars, Panel, Picture, Result

_COLOURS = ("#1f6fb2", "#d9822b", "#7a869a", "#2f9e6e", "#b5485d")
# Not the colours of the curves beside them, each of which stands for a trainer.
_BAR_COLOURS = ("#2f9e6e", "#8e6bbf", "#c3cad4", "#e0b040", "#b5485d")
_GRID = {"color": "#e3e7eb", "linewidth": 0.8}


def file_name(picture: Picture) -> str:
    return f"bench-{picture.name}.png"


def draw(results: Iterable[Result], folder: Path) -> list[Path]:
    """Draw every picture of every result; returns the paths."""
    return [_drawn(picture, folder / file_name(picture)) for one in results for picture in one.pictures]


def _drawn(picture: Picture, path: Path) -> Path:
    from matplotlib.figure import Figure

    columns = min(3, len(picture.panels))
    rows = -(-len(picture.panels) // columns)
    wide = max(1.0, *(_width(panel) for panel in picture.panels))
    figure = Figure(figsize=(4.6 * columns * wide, 3.4 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, panel in zip(axes, picture.panels, strict=False):
        match panel:
            case Panel():
                _curves(axis, panel)
            case Bars():
                _bars(axis, panel)
    for axis in axes[len(picture.panels) :]:
        axis.set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    # Without the time and the program's version, equal results give equal files.
    figure.savefig(path, dpi=130, metadata={"Software": None})
    return path


def _width(panel: Panel | Bars) -> float:
    return 1.0 if isinstance(panel, Panel) or len(panel.groups) < 6 else 1.8


def _curves(axis: Any, panel: Panel) -> None:
    colours: dict[str, str] = {}
    fresh = cycle(_COLOURS)
    for line in panel.lines:
        new = line.label not in colours
        colour = colours.setdefault(line.label, next(fresh) if new else "")
        x, y = zip(*line.points, strict=True)
        axis.plot(
            x,
            y,
            color=colour,
            linewidth=1.6,
            marker="o",
            markersize=3,
            alpha=0.85,
            label=line.label if new else None,
        )
    axis.set_xlabel(panel.x)
    axis.set_ylabel(panel.y)
    axis.xaxis.set_major_formatter(_compact)
    axis.yaxis.set_major_formatter(_compact)
    axis.set_xlim(left=0)
    _dress(axis, panel.title, grid="both")


def _bars(axis: Any, bars: Bars) -> None:
    """Draw bars; stacked ones are horizontal, so that the names of the groups have room."""
    if bars.stacked:
        _stacks(axis, bars)
    else:
        _side_by_side(axis, bars)


def _stacks(axis: Any, bars: Bars) -> None:
    left = [0.0] * len(bars.groups)
    for (label, values), colour in zip(bars.series.items(), cycle(_BAR_COLOURS), strict=False):
        lengths = [max(0.0, value or 0.0) for value in values]
        axis.barh(bars.groups, lengths, left=left, color=colour, label=label, height=0.6)
        left = [a + b for a, b in zip(left, lengths, strict=True)]
    for place, whole in enumerate(left if bars.unit != "%" else ()):
        axis.annotate(
            f"{whole:.3g}", (whole, place), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8
        )
    axis.invert_yaxis()
    axis.set_xlabel(bars.unit)
    axis.margins(x=0.12)
    _dress(axis, bars.title, grid="x", below=True)


def _side_by_side(axis: Any, bars: Bars) -> None:
    width = 0.8 / len(bars.series)
    for number, (label, values) in enumerate(bars.series.items()):
        places = [group - 0.4 + (number + 0.5) * width for group in range(len(bars.groups))]
        shown = axis.bar(
            places, [value or 0.0 for value in values], width, label=label, color=_BAR_COLOURS[number]
        )
        texts = ["" if value is None else _compact(float(f"{value:.2g}")) for value in values]
        axis.bar_label(shown, texts, fontsize=7, padding=3, rotation=90)
    axis.set_xticks(range(len(bars.groups)), bars.groups, rotation=20 if len(bars.groups) > 4 else 0)
    axis.set_ylabel(bars.unit)
    axis.yaxis.set_major_formatter(_compact)
    axis.margins(y=0.15)
    _dress(axis, bars.title, grid="y", below=True)


def _dress(axis: Any, title: str, *, grid: str, below: bool = False) -> None:
    axis.set_title(title, loc="left", fontsize=10)
    axis.grid(axis=grid, **_GRID)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
    axis.tick_params(labelsize=8)
    if below:
        axis.legend(frameon=False, fontsize=8, loc="upper center", bbox_to_anchor=(0.45, -0.2), ncols=3)
    else:
        axis.legend(frameon=False, fontsize=8)


def _compact(value: float, _position: Any = None) -> str:
    """3000000 as `3 M`, 250000 as `250 k`."""
    for size, letter in ((1e6, "M"), (1e4, "k")):
        if abs(value) >= size:
            return f"{value / (1e3 if letter == 'k' else size):g} {letter}"
    return f"{value:g}"
