"""Terms of one model: which fields of the physics each reads, and its value in a step."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from core.environments.patterns import by_name
from core.environments.terms.actions import JointPositionAction
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
    nothing = np.zeros(model.model.nu)
    each_foot = np.zeros(len(model.feet))
    step = Step(
        physics, physics, nothing, nothing, 1.0, np,
        command=np.zeros(model.num_commands),
        target=np.zeros(2),
        phases=each_foot,
        start=np.zeros(3),
        foot_times=FootTimes(*[each_foot] * 5),
        earlier_action=nothing,
        control=nothing,
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


def servo_targets(
    action: JointPositionAction, model: mujoco.MjModel, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The controls [nu] for an action of 0, and what an action of 1 adds to them. pose: positions [nq].

    Raises JobFailed("bad_model") for an actuator that is no position servo of a joint.
    """
    on_a_joint = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
    others = np.flatnonzero(~on_a_joint | (model.actuator_biasprm[:, 1] >= 0))
    if others.size:
        name = model.actuator(others[0]).name
        raise JobFailed(
            Reason.BAD_MODEL,
            f"The actuator {name!r} is no position servo, so an action cannot be its target: give its joint "
            "one in `edits.servos`, or take the action `control`.",
        )
    joints = model.actuator_trnid[:, 0]
    names = [model.joint(joint).name for joint in joints]
    stiffness, forces = model.actuator_gainprm[:, 0], model.actuator_forcerange[:, 1]
    limited = model.actuator_forcelimited.astype(bool)
    scale = np.where(limited, 0.5 * forces / np.maximum(stiffness, 1e-9), 0.25)
    if isinstance(action.scale, dict):
        chosen = by_name(action.scale, names)
        scale = np.array([chosen.get(name, own) for name, own in zip(names, scale, strict=True)])
    elif action.scale is not None:
        scale = np.full(model.nu, action.scale)
    return pose[model.jnt_qposadr[joints]].astype(np.float32), scale.astype(np.float32)
