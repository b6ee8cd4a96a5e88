"""Pictures of a run. matplotlib (extra `plots`) is loaded only when one is drawn."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

_STYLES: dict[str, dict[str, Any]] = {
    "training": {"color": "#9aa5b1", "linewidth": 1.2, "label": "training"},
    "eval": {"color": "#1f6fb2", "linewidth": 2, "marker": "o", "markersize": 4, "label": "evaluation"},
}
# What an axis says, by the name of the metric after `eval/` and `training/`.
_PANELS = {"episode_reward": "return per episode", "forward_speed": "forward speed in m/s"}

Series = tuple[list[float], list[float]]


def learning_curve(rows: Iterable[Mapping[str, Any]], path: Path, *, title: str = "") -> None:
    """Draw return and forward speed against environment steps, and store the picture (type by its suffix).

    rows: those of `GET /jobs/{id}/metrics`, each with `step` and `values`; `eval/...` and
    `training/...` are drawn apart. A quantity that was never measured gets no panel.
    """
    from matplotlib.figure import Figure

    table = list(rows)
    panels = {name: _both(table, name) for name in _PANELS}
    panels = {name: drawn for name, drawn in panels.items() if _any(drawn)} or {"episode_reward": {}}
    figure = Figure(figsize=(7, 2.6 * len(panels) + 0.6), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axis, (name, drawn) in zip(axes, panels.items(), strict=True):
        _draw(axis, _PANELS[name], drawn)
    if any(_any(drawn) for drawn in panels.values()):
        axes[0].legend(frameon=False, fontsize=9)
    axes[-1].set_xlabel("environment steps")
    axes[-1].xaxis.set_major_formatter(_compact)
    if title:
        axes[0].set_title(title, loc="left", fontsize=11)
    figure.savefig(path, dpi=144)  # pyright: ignore[reportUnknownMemberType]


def series(rows: Iterable[Mapping[str, Any]], name: str) -> Series:
    """Steps and values of the rows that have the metric, in the order of the steps."""
    points = sorted((float(row["step"]), float(row["values"][name])) for row in rows if name in row["values"])
    return [step for step, _ in points], [value for _, value in points]


def _both(rows: list[Mapping[str, Any]], name: str) -> dict[str, Series]:
    return {kind: series(rows, f"{kind}/{name}") for kind in _STYLES}


def _any(drawn: Mapping[str, Series]) -> bool:
    return any(steps for steps, _ in drawn.values())


def _draw(axis: Any, label: str, drawn: Mapping[str, Series]) -> None:
    for kind, style in _STYLES.items():
        if kind in drawn and drawn[kind][0]:
            axis.plot(*drawn[kind], **style)
    axis.set_ylabel(label)
    axis.grid(axis="y", color="#e3e7eb", linewidth=0.8)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
    axis.margins(x=0.02)


def _compact(value: float, _position: Any = None) -> str:
    """3000000 as `3 M`, 250000 as `250 k`."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:g} {letter}"
    return f"{value:g}"
