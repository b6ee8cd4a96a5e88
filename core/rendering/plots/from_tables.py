"""The plots of a tabular agent, from arrays under the names that a trainer gives them."""

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from core.rendering.plots.tables import q_table, visit_counts


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
