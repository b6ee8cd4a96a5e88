"""The parts of our environments' bodies that name their numbers, from a table made of the models.

`python -m core.environments.describe_bodies` makes the table.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

TABLE = Path(__file__).parent / "bodies.json"
JointType = Literal["free", "ball", "slide", "hinge"]


@dataclass(frozen=True)
class Body:
    """joints: by name, in MuJoCo's order. controls: of each actuator, by its name or that of its joint, the
    control's range. bodies: all but the world; () if not all of them have names."""

    joints: Mapping[str, JointType]
    controls: Mapping[str, tuple[float, float]]
    bodies: tuple[str, ...] = ()


@cache
def body(name: str) -> Body:
    """The body of this environment; of the corridor that of a walker, `corridor/<walker>`."""
    row = _table()[name]
    controls = {actuator: (low, high) for actuator, (low, high) in row["controls"].items()}
    return Body(row["joints"], controls, tuple(row["bodies"]))


@cache
def _table() -> dict[str, Any]:
    return json.loads(TABLE.read_text())
