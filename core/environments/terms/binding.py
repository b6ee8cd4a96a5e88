"""Terms of one model: which fields of the physics each reads, and its value in a step."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from core.environments.terms.foot_times import FootTimes
from core.environments.terms.step import ModelIndex, Step
from core.environments.terms.term import Array, Term


@dataclass(frozen=True)
class BoundTerm:
    """derived: the fields that it reads. size: how many numbers it has. measure: its value, [] or [n]."""

    derived: frozenset[str]
    size: int
    measure: Callable[[Step], Array]


def bound(term: Term, model: ModelIndex) -> BoundTerm:
    """The term of this model, after it has been evaluated in the model's own state."""
    data = mujoco.MjData(model.model)
    mujoco.mj_forward(model.model, data)
    derived = _Noted(data)
    physics = SimpleNamespace(qpos=data.qpos, qvel=data.qvel, act=data.act, derived=derived, model={})
    nothing = np.zeros(model.num_actions)
    each_foot = np.zeros(len(model.feet))
    step = Step(
        physics, physics, nothing, nothing, 1.0, np,
        command=np.zeros(model.num_commands),
        target=np.zeros(2),
        phases=each_foot,
        start=np.zeros(3),
        foot_times=FootTimes(*[each_foot] * 5),
        earlier_action=nothing,
        control=np.zeros(model.model.nu),
    )  # fmt: skip
    size = np.size(term.measure(step, model))
    return BoundTerm(frozenset(derived.read), size, lambda step: term.measure(step, model))


class _Noted(Mapping[str, np.ndarray]):
    """The derived fields of MuJoCo's data; it notes which are read."""

    def __init__(self, data: Any) -> None:
        self._data = data
        self.read: set[str] = set()

    def __getitem__(self, name: str) -> np.ndarray:
        self.read.add(name)
        return getattr(self._data, name)

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0
