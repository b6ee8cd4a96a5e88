"""The look of all plots: size, grid, and colours that colour-blind readers can tell apart."""

import os
from pathlib import Path
from typing import Any

# Okabe and Ito, Color Universal Design (2008).
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8c6d1f")
GREY = "#7a869a"
WIDTH_IN = 6.4
# Twice what a page of 640 pixels needs, and enough for print.
_DPI = 200
_GRID = {"color": "#e3e7eb", "linewidth": 0.8}


def new_figure(height_in: float, title: str = "", *, width_in: float = WIDTH_IN) -> Any:
    """A matplotlib Figure without a window. title: at the top left."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure


def plain(axes: Any) -> None:
    """Leave only the two axes of the frame, and draw a light grid behind everything."""
    axes.grid(**_GRID)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def save(figure: Any, path: Path) -> None:
    """Store a PNG, complete or not at all; equal figures give equal bytes."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        figure.savefig(part, dpi=_DPI, format="png", metadata={"Software": None})
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def compact(value: float) -> str:
    """Three digits: 12345 as `12.3k`, 4000000 as `4M`."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:.3g}{letter}"
    return f"{value:.3g}"
