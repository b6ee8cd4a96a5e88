"""Terms of one model: which fields of the physics each reads, and its value in a step."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from core.environments.terms.memory import FootTimes
from core.environments.terms.reference import Following, Frame
from core.environments.terms.step import ModelIndex, Step
from core.environments.terms.term import Array, Term
from core.errors import JobFailed
from core.reasons import Reason


@dataclass(frozen=True)
class BoundTerm:
    """derived: the fields that it reads. size: how many numbers it has. measure: its value, [] or [n], in a
    step and for what else its method takes."""

    derived: frozenset[str]
    size: int
    measure: Callable[..., Array]


def bound(
    term: Term, model: ModelIndex, method: str = "measure", *given: np.ndarray, size: int | None = None
) -> BoundTerm:
    """The term of this model, after a method of it has been evaluated in the model's own state.

    given: the method's arguments before the step. size: how many numbers the value must have. Raises
    JobFailed where the code of a plugin's term fails.
    """
    data = mujoco.MjData(model.model)
    mujoco.mj_forward(model.model, data)
    derived = _Noted(data)
    physics = SimpleNamespace(qpos=data.qpos, qvel=data.qvel, act=data.act, derived=derived, model={})
    nothing = np.zeros(model.num_actions)
    each_foot = np.zeros(len(model.feet))
    step = Step(
        physics, physics, nothing, nothing, 1.0, np,
        command=np.zeros(model.num_commands),
        target=np.zeros(model.num_targets),
        phases=each_foot,
        start=np.zeros(3),
        foot_times=FootTimes(*[each_foot] * 5),
        earlier_action=nothing,
        control=np.zeros(model.model.nu),
        following=_following(data, model),
    )  # fmt: skip
    measure = partial(_measured, term, model, method)
    number = np.size(measure(step, *given))
    if size is not None and number != size:
        detail = f"The {term.noun} {term.label} gives {number} numbers by `{method}`, and should give {size}."
        raise JobFailed(Reason.BAD_MODEL, detail)
    return BoundTerm(frozenset(derived.read), number, measure)


def _following(data: mujoco.MjData, model: ModelIndex) -> Following | None:
    """A reference that is the model's own state; None for a body that follows none."""
    if (followed := model.followed_parts) is None:
        return None
    bodies, nothing = followed.bodies, np.zeros((len(followed.bodies), 3))
    now = Frame(data.qpos, data.qvel, data.xpos[bodies], data.xquat[bodies], nothing, nothing)
    ahead = Frame(*(np.stack([values] * model.frames_ahead) for values in now))
    return Following(now, ahead, np.zeros(()))


def _measured(term: Term, model: ModelIndex, method: str, step: Step, *given: Array) -> Array:
    """The term's value. Raises JobFailed where the code of a plugin's term fails."""
    try:
        return getattr(term, method)(*given, step, model)
    except Exception as error:
        if "/" not in term.label:
            raise
        words = f"{type(error).__name__}: {error}".splitlines()[0][:500]
        detail = f"The {term.noun} {term.label} cannot be computed. {words}"
        raise JobFailed(Reason.BAD_MODEL, detail) from error


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
