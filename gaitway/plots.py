"""Pictures of a run. matplotlib (extra `plots`) is loaded only when one is drawn."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_STYLES: dict[str, dict[str, Any]] = {
    "training": {"color": "#9aa5b1", "linewidth": 1.2, "label": "training"},
    "eval": {"color": "#1f6fb2", "linewidth": 2, "marker": "o", "markersize": 4, "label": "evaluation"},
}
# One for each term of the reward; distinguishable by colour-blind readers, too (Okabe and Ito, 2008).
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8c6d1f")
# The names of metrics that are terms of the reward; the return is not one of them.
_TERM = re.compile(r"training/(?:reward[_/]?(?P<after>.+)|(?P<before>(?!episode)\w+)_reward)")

Rows = Sequence[Mapping[str, Any]]
Series = tuple[list[float], list[float]]


@dataclass(frozen=True)
class _Panel:
    """How one quantity is drawn.

    training, evaluation: its metrics without `training/` and `eval/`. bounds: the least that the axis shows.
    unless: a better metric of training; where that was measured, this panel is left out.
    """

    label: str
    training: str
    evaluation: str | None = None
    bounds: tuple[float, float] | None = None
    unless: str | None = None

    def draw(self, axis: Any, rows: Rows) -> None:
        for kind, name in (("training", self.training), ("eval", self.evaluation)):
            points = series(rows, f"{kind}/{name}")
            if points[0]:
                axis.plot(*points, **_STYLES[kind])
        if self.bounds is not None:
            low, high = axis.get_ylim()
            axis.set_ylim(min(low, self.bounds[0]), max(high, self.bounds[1]))
        axis.set_ylabel(self.label)


# The most asked for first; a quantity that was never measured is left out.
_PANELS = (
    _Panel("return per episode", "episode_reward", "episode_reward"),
    _Panel("forward speed in m/s", "forward_speed", "forward_speed"),
    _Panel("steps per episode", "episode_length", "avg_episode_length", (0.0, 0.0)),
    _Panel("share of episodes that fell", "fall_rate", bounds=(-0.02, 1.02)),
    _Panel("control effort (mean action²)", "control_effort", bounds=(0.0, 0.0)),
    _Panel("height in m", "height"),
    _Panel("distance from the start in m", "distance_from_start"),
    _Panel("distance from the origin in m", "distance_from_origin", unless="distance_from_start"),
)


def learning_curve(rows: Iterable[Mapping[str, Any]], path: Path, *, title: str = "") -> None:
    """Draw a run's metrics against environment steps, and save the picture (type by its suffix).

    rows: those of `GET /jobs/{id}/metrics`, each with `step` and `values`. Panels: the return, with a band
    of one standard deviation over the evaluation's episodes; the speed; each term of the reward by step;
    and how long episodes are, how many fall, the control effort, height and distance. Values of training
    and of evaluations are drawn separately. What was never measured gets no panel.
    """
    from matplotlib.figure import Figure

    table = list(rows)
    panels = [panel.draw for panel in _PANELS if _is_measured(table, panel)] or [_PANELS[0].draw]
    if _terms(table):
        panels.insert(min(2, len(panels)), _draw_terms)
    columns = 1 if len(panels) == 1 else 2
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(5.2 * columns + 1, 2.5 * lines + 0.6), layout="constrained")
    axes = list(figure.subplots(lines, columns, sharex=True, squeeze=False).flat)
    for axis, draw in zip(axes, panels, strict=False):
        _prepare(axis)
        draw(axis, table)
    for axis in axes[len(panels) :]:
        axis.remove()
    for axis in axes[: len(panels)][-columns:]:
        axis.set_xlabel("environment steps")
        axis.tick_params(labelbottom=True)
    _draw_deviation(axes[0], table)
    if axes[0].lines:
        axes[0].legend(frameon=False, fontsize=9)
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)  # pyright: ignore[reportUnknownMemberType]
    figure.savefig(path, dpi=144)  # pyright: ignore[reportUnknownMemberType]


def series(rows: Iterable[Mapping[str, Any]], name: str) -> Series:
    """Steps and values of the rows that have the metric, in the order of the steps."""
    points = sorted(
        (float(row["step"]), float(row["values"][name]))
        for row in rows
        if row["values"].get(name) is not None  # None: it was not finite
    )
    return [step for step, _ in points], [value for _, value in points]


def _is_measured(rows: Rows, panel: _Panel) -> bool:
    measured = {name for row in rows for name, value in row["values"].items() if value is not None}
    names = {f"training/{panel.training}", f"eval/{panel.evaluation}"}
    return bool(measured & names) and f"training/{panel.unless}" not in measured


def _terms(rows: Rows) -> dict[str, Series]:
    """The terms of the reward by name, without those that were always 0 or that Brax reports twice."""
    found = dict[str, Series]()
    for name in sorted({name for row in rows for name in row["values"]}, reverse=True):
        term, points = _TERM.fullmatch(name), series(rows, name)
        told_twice = term and term["before"] and points in found.values()
        if term and any(points[1]) and not told_twice:
            found[term["after"] or term["before"]] = points
    return dict(sorted(found.items()))


def _draw_terms(axis: Any, rows: Rows) -> None:
    for number, (name, points) in enumerate(_terms(rows).items()):
        style = "-" if number < len(_COLOURS) else "--"
        axis.plot(*points, label=name, color=_COLOURS[number % len(_COLOURS)], linewidth=1.3, linestyle=style)
    axis.axhline(0, color="#9aa5b1", linewidth=0.6)
    axis.set_ylabel("reward per step, by term")
    axis.legend(frameon=False, fontsize=8, ncols=2)


def _draw_deviation(axis: Any, rows: Rows) -> None:
    """One standard deviation over an evaluation's episodes, around their mean return."""
    steps, means = series(rows, "eval/episode_reward")
    with_deviation, deviations = series(rows, "eval/episode_reward_std")
    if steps and steps == with_deviation:
        low = [mean - deviation for mean, deviation in zip(means, deviations, strict=True)]
        high = [mean + deviation for mean, deviation in zip(means, deviations, strict=True)]
        axis.fill_between(steps, low, high, color=_STYLES["eval"]["color"], alpha=0.15, linewidth=0)


def _prepare(axis: Any) -> None:
    axis.grid(axis="y", color="#e3e7eb", linewidth=0.8)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
    axis.margins(x=0.02)
    formatter: Callable[..., str] = _compact
    axis.xaxis.set_major_formatter(formatter)


def _compact(value: float, _position: Any = None) -> str:
    """3000000 as `3 M`, 250000 as `250 k`."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:g} {letter}"
    return f"{value:g}"
