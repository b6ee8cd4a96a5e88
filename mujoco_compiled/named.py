"""Sentences about a model's elements, by their names."""

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np


def where(
    model: mujoco.MjModel, kind: str, found: Any, words: str, numbers: np.ndarray | None = None
) -> Iterator[str]:
    """The first element for which `found` is true. numbers: the elements' own, if not their places."""
    for place in np.flatnonzero(found)[:1]:
        yield f"its {kind} {named(model, kind, int(place if numbers is None else numbers[place]))} {words}"


def named(model: mujoco.MjModel, kind: str, number: int) -> str:
    """The element's name in quotes, or its number."""
    name = mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), number)
    return f"'{name}'" if name else f"number {number}"


def word(member: str) -> str:
    """The last part of an enumeration's name, as a model's XML has it."""
    return member.rsplit("_", 1)[-1].lower()
