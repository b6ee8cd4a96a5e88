"""Terms of one model: which fields of the physics each reads, and its value in a step."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from core.environments.terms.foot_times import FootTimes
from core.environments.terms.step import ModelIndex, Step
from core.environments.terms.term import Array, Term
from core.errors import JobFailed
from core.reasons import Reason


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
    measure = partial(_measured, term, model)
    size = np.size(measure(step))
    return BoundTerm(frozenset(derived.read), size, measure)


def _measured(term: Term, model: ModelIndex, step: Step) -> Array:
    """The term's value. Raises JobFailed where the code of a plugin's term fails."""
    try:
        return term.measure(step, model)
    except Exception as error:
        if "/" not in term.label:
            raise
        words = f"{type(error).__name__}: {error}".splitlines()[0][:500]
        raise JobFailed(Reason.BAD_MODEL, f"The term {term.label} cannot be computed. {words}") from error


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
