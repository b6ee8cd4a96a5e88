"""A tabular agent's values and visits: heat maps of states by actions."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.rendering.plots.style import compact, new_figure

Numbers = NDArray[Any]

# In a table up to this size, each cell has room for its number.
_MAX_STATES, _MAX_ACTIONS = 16, 9
# More states than these run along the width.
_TALLEST = 48
_UNTRIED: dict[str, Any] = {"hatch": "////", "edgecolor": "#9aa5b1", "facecolor": "#f4f5f7", "linewidth": 0.0}


def q_table(
    values: Numbers,
    *,
    visits: Numbers | None = None,
    states: Sequence[str] = (),
    actions: Sequence[str] = (),
    title: str = "",
) -> Any:
    """A figure of the value of each action in each state, the greedy action framed.

    values, visits: [states, actions], or [agents, states, actions], which are shown by their mean and sum;
    a frame is then solid where all agents agree. Cells that no agent has tried are hatched: their value is
    the initial one. A state whose actions are all worth the same has no greedy action.
    states, actions: names, by default numbers.
    """
    tables = _by_agent(values)
    shown = tables.mean(axis=0)
    untried = np.zeros(shown.shape, bool) if visits is None else _by_agent(visits).sum(axis=0) == 0
    sheet = _Sheet(shown, states, actions, title)
    image = sheet.colour(np.where(untried, np.nan, shown), cmap="viridis", vmin=shown.min(), vmax=shown.max())
    sheet.write(shown, untried, image, _digits(shown))
    decided = np.flatnonzero(np.ptp(shown, axis=1) > 0)
    greedy = shown.argmax(axis=1)
    agree = (tables.argmax(axis=2) == greedy).all(axis=0)
    sheet.frame(decided, greedy[decided], agree[decided])
    sheet.scale(image, "Q(s, a): discounted return to come")
    marks = [("greedy action", "solid")]
    if len(tables) > 1:
        marks = [("greedy of all agents", "solid"), ("greedy of the mean; agents differ", "dashed")]
    sheet.explain(marks, untried=bool(untried.any()))
    return sheet.figure


def visit_counts(
    visits: Numbers, *, states: Sequence[str] = (), actions: Sequence[str] = (), title: str = ""
) -> Any:
    """A figure of how often each action was taken in each state, on a logarithmic scale; hatched if never.

    visits: [states, actions], or [agents, states, actions], which are summed over the agents.
    """
    from matplotlib.colors import LogNorm

    tables = _by_agent(visits)
    counts = tables.sum(axis=0).astype(float)
    sheet = _Sheet(counts, states, actions, title)
    norm = LogNorm(vmin=1, vmax=max(10.0, float(counts.max(initial=0))))
    image = sheet.colour(np.where(counts > 0, counts, np.nan), cmap="Blues", norm=norm)
    sheet.write(counts, counts == 0, image, compact)
    sheet.scale(image, "times that the action was taken (log)")
    sheet.explain([], untried=bool((counts == 0).any()))
    return sheet.figure


class _Sheet:
    """States by actions: states are the rows, or the columns if there are many."""

    def __init__(self, table: Numbers, states: Sequence[str], actions: Sequence[str], title: str) -> None:
        self._lies = table.shape[0] > _TALLEST
        self._is_small = table.shape[0] <= _MAX_STATES and table.shape[1] <= _MAX_ACTIONS
        rows = table.shape[1] if self._lies else table.shape[0]
        self.figure = new_figure(min(6.4, max(3.0, 1.7 + 0.42 * rows)), title)
        self._axes = self.figure.subplots()
        along, up = ("x", "y") if self._lies else ("y", "x")
        self._name(along, "state", table.shape[0], states)
        self._name(up, "action", table.shape[1], actions)
        self._axes.spines[:].set_visible(False)
        self._axes.tick_params(length=0)

    def colour(self, table: Numbers, **style: Any) -> Any:
        """Draw the table; NaN shows the hatched ground."""
        self._axes.patch.set(**_UNTRIED)
        return self._axes.imshow(
            table.T if self._lies else table, aspect="auto", interpolation="nearest", **style
        )

    def write(
        self, table: Numbers, untried: NDArray[np.bool_], image: Any, digits: Callable[[float], str]
    ) -> None:
        """Write each cell's number in black or white, whichever is more legible on its colour."""
        if not self._is_small:
            return
        for state, action in np.ndindex(*table.shape):
            value = float(table[state, action])
            colour, behind = _ink(image.cmap(image.norm(value))), None
            if untried[state, action]:
                colour, behind = "black", {"facecolor": "#f4f5f7", "edgecolor": "none", "pad": 1.5}
            style = {"ha": "center", "va": "center", "fontsize": 9, "color": colour, "bbox": behind}
            self._axes.text(action, state, digits(value), **style)

    def frame(self, states: Numbers, actions: Numbers, solid: NDArray[np.bool_]) -> None:
        """Frame cells in black and white, which is visible on any colour."""
        if self._lies:
            self._axes.plot(
                states, actions, linestyle="none", marker="o", ms=2.2, mfc="white", mec="black", mew=0.4
            )
            return
        inset, wide = (0.07, 3.4) if self._is_small else (0.0, 1.8)
        for state, action, whole in zip(states, actions, solid, strict=True):
            self._box(state, action, inset, edgecolor="black", linewidth=wide)
            self._box(state, action, inset, edgecolor="white", linewidth=wide / 2, linestyle=_line(whole))

    def scale(self, image: Any, label: str) -> None:
        self.figure.colorbar(image, ax=self._axes, label=label, pad=0.02, fraction=0.06)

    def explain(self, frames: Sequence[tuple[str, str]], *, untried: bool) -> None:
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        marks: list[Any] = []
        for label, style in frames:
            if self._lies:
                marks.append(
                    Line2D([], [], ls="none", marker="o", ms=4, mfc="white", mec="black", label=label)
                )
                break
            cell: dict[str, Any] = {"facecolor": "white", "edgecolor": "black", "linewidth": 1.5}
            marks.append(Patch(linestyle=_line(style == "solid"), label=label, **cell))
        if untried:
            marks.append(Patch(**_UNTRIED, label="never tried"))
        if marks:
            self.figure.legend(
                handles=marks, loc="outside lower center", ncols=len(marks), frameon=False, fontsize=9
            )

    def _box(self, state: int, action: int, inset: float, **style: Any) -> None:
        from matplotlib.patches import Rectangle

        corner, side = (action - 0.5 + inset, state - 0.5 + inset), 1 - 2 * inset
        self._axes.add_patch(Rectangle(corner, side, side, fill=False, **style))

    def _name(self, axis: str, what: str, count: int, names: Sequence[str]) -> None:
        self._axes.set(**{f"{axis}label": what})
        if names:
            slanted = axis == "x" and max(map(len, names)) * count > 60
            turn = {"rotation": 30, "ha": "right"} if slanted else {}
            self._axes.set(**{f"{axis}ticks": range(count)})
            self._axes.set(**{f"{axis}ticklabels": names})
            self._axes.tick_params(axis=axis, labelsize=8 if count > 20 else 10)
            for label in getattr(self._axes, f"get_{axis}ticklabels")():
                label.set(**turn)
        elif count <= _TALLEST // 2:
            self._axes.set(**{f"{axis}ticks": range(count)})


def _line(solid: bool) -> Any:
    return "solid" if solid else (0, (3, 2))


def _ink(colour: Sequence[float]) -> str:
    red, green, blue, *_ = colour
    return "white" if 0.299 * red + 0.587 * green + 0.114 * blue < 0.5 else "black"


def _digits(table: Numbers) -> Callable[[float], str]:
    """Equally many decimals in all cells: three digits of the largest value."""
    largest = float(np.abs(table).max())
    decimals = 2 - int(np.floor(np.log10(largest))) if largest > 0 else 0
    if not 0 <= decimals <= 4:
        return compact
    return lambda value: f"{value:.{decimals}f}".replace("-", "−")


def _by_agent(table: Numbers) -> Numbers:
    """[agents, states, actions]. Raises ValueError for other numbers of axes."""
    if table.ndim not in (2, 3):
        raise ValueError(f"A table has the axes ([agents,] states, actions), this one has {table.ndim}.")
    return table if table.ndim == 3 else table[None]


def pictures(tables: Mapping[str, NDArray[Any]], *, title: str = "") -> dict[str, Any]:
    """Figures by the name of their file, one for each known table that is given.

    q_table, visits: [states, actions] or [agents, states, actions]. state_names, action_names: text [states]
    and [actions].
    """
    found: dict[str, Any] = {}
    names: dict[str, Any] = {
        what: [str(name) for name in tables.get(key, ())]
        for what, key in (("states", "state_names"), ("actions", "action_names"))
    }
    before = f"{title}: " if title else ""
    if "q_table" in tables:
        shown = tables["q_table"]
        found["q_table"] = q_table(
            shown, visits=tables.get("visits"), title=f"{before}{_of('Q-table', shown, 'mean')}", **names
        )
    if "visits" in tables:
        shown = tables["visits"]
        found["visits"] = visit_counts(shown, title=f"{before}{_of('visits', shown, 'sum')}", **names)
    return found


def _of(what: str, table: NDArray[Any], how: str) -> str:
    return what if table.ndim < 3 or len(table) == 1 else f"{what}, {how} of {len(table)} agents"
