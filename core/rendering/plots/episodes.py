"""Learning curves by episode: the return and epsilon."""

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.rendering.plots.style import COLOURS, GREY, new_figure, plain

Floats = NDArray[np.floating[Any]]

_OF_AN_AGENT = re.compile(r"training/agent_(\d+)/episode_reward")


def from_metrics(rows: Iterable[Mapping[str, Any]], *, title: str = "") -> Any | None:
    """The figure of a run whose metrics have `training/epsilon`; None for any other.

    rows: as in `GET /jobs/{id}/metrics`. Names: `training/episode_reward`, or for several agents
    `training/agent_<i>/episode_reward`, likewise `epsilon`; `training/episodes`, the episodes so far; without
    it, rows are counted.
    """
    table = [row for row in sorted(rows, key=lambda row: row["step"]) if "training/epsilon" in row["values"]]
    table = [row["values"] for row in table if row["values"].get("training/episode_reward") is not None]
    if not table:
        return None
    found = {match[1] for name in table[0] if (match := _OF_AN_AGENT.fullmatch(name))}
    agents = [f"agent_{number}/" for number in sorted(found, key=int)] or [""]

    def of_each(name: str) -> Floats:
        common = f"training/{name}"
        return np.array(
            [[row.get(f"training/{a}{name}", row[common]) for row in table] for a in agents], float
        )

    counted = all("training/episodes" in row for row in table)
    episodes = np.array([row["training/episodes"] for row in table], float) if counted else None
    return episode_curves(
        of_each("episode_reward"), episodes=episodes, epsilon=of_each("epsilon"), title=title
    )


def episode_curves(
    returns: Floats,
    *,
    episodes: Floats | None = None,
    epsilon: Floats | None = None,
    window: int | None = None,
    title: str = "",
) -> Any:
    """A figure of the return by episode and, below it, of epsilon.

    returns, epsilon: [points], or [agents, points]. episodes: [points], how many each agent has made so far;
    by default each point is one. The thick line is the moving mean over `window` points (by default a
    twentieth of them), averaged over the agents; the band holds the middle 80 % of agents, and thin lines
    are single points (of one agent) or single agents (of several).
    """
    rows = np.atleast_2d(np.asarray(returns, float))
    x = np.arange(1, rows.shape[1] + 1) if episodes is None else np.asarray(episodes, float)
    window = max(1, len(x) // 20) if window is None else window
    heights = (1,) if epsilon is None else (3, 1)
    figure = new_figure(3.6 if epsilon is None else 4.8, title)
    panels = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    (_draw_one if len(rows) == 1 else _draw_several)(panels[0], x, rows, window)
    panels[0].set_ylabel("return per episode")
    panels[0].legend(frameon=False, fontsize=9, loc="best")
    if epsilon is not None:
        _draw_epsilon(panels[1], x, np.atleast_2d(np.asarray(epsilon, float)))
    panels[-1].set_xlabel("episode")
    panels[-1].set_xlim(0, max(1.0, float(x.max())))
    for panel in panels:
        if len(x) == 1:  # A run of one round is one point, which needs a marker to be seen.
            for line in panel.lines:
                line.set(marker="o", clip_on=False)
        plain(panel)
    return figure


def moving_mean(rows: Floats, window: int) -> Floats:
    """The mean of each point and the `window - 1` before it, or of fewer at the beginning.

    rows: [agents, points]; returns the same shape.
    """
    sums = np.cumsum(rows, axis=1)
    sums[:, window:] -= sums[:, :-window].copy()
    return sums / np.minimum(np.arange(1, rows.shape[1] + 1), window)


def _draw_one(axes: Any, x: Floats, rows: Floats, window: int) -> None:
    if window > 1:
        axes.plot(x, rows[0], color=GREY, linewidth=0.8, alpha=0.6, label="as measured")
    label = f"mean of {window} points" if window > 1 else "as measured"
    axes.plot(x, moving_mean(rows, window)[0], color=COLOURS[0], linewidth=2.2, label=label)


def _draw_several(axes: Any, x: Floats, rows: Floats, window: int) -> None:
    smooth = moving_mean(rows, window)
    low, high = np.quantile(smooth, (0.1, 0.9), axis=0)
    faint: dict[str, Any] = {"color": GREY, "linewidth": 0.6, "alpha": max(0.15, min(0.6, 8 / len(rows)))}
    for number, row in enumerate(smooth):
        axes.plot(x, row, label="one agent" if number == 0 else None, **faint)
    axes.fill_between(x, low, high, color=COLOURS[0], alpha=0.18, linewidth=0, label="80 % of agents")
    label = f"mean of {len(rows)} agents" + (f" and {window} points" if window > 1 else "")
    axes.plot(x, smooth.mean(axis=0), color=COLOURS[0], linewidth=2.2, label=label)


def _draw_epsilon(axes: Any, x: Floats, rows: Floats) -> None:
    different = np.unique(rows, axis=0)
    for row in different:
        axes.plot(x, row, color=COLOURS[1], linewidth=2.0 if len(different) == 1 else 1.0)
    axes.set_ylim(-0.03, max(0.1, float(rows.max(initial=0))) * 1.08)
    axes.set_ylabel("ε, share of\nrandom actions")
