"""A job's battery in words: the test of a policy that follows velocity commands (docs/battery.md)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

_NAMES = {
    "falls": "falls",
    "linear_tracking": "velocity",
    "angular_tracking": "turning",
    "action_change": "actions",
    "target_change": "targets",
    "torso_rate": "torso",
    "yaw_rate": "yaw",
    "leg_velocity": "legs",
}
LEGEND = (
    "Velocity and turning: means of exp(-e² / 0.25). Root mean squares: the change of the legs' actions, and "
    "of their targets in rad; the torso's roll and pitch, its yaw, and the legs' joints, in rad/s."
)
_MEASURED = tuple(name for name in _NAMES if name != "falls")


@dataclass(frozen=True)
class ShownBattery:
    """verdict: a sentence. criteria: quantity, value, bound, whether it holds. rows: one for each command."""

    verdict: str
    criteria: Sequence[tuple[str, str, str, str]]
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def shown_battery(facts: Mapping[str, Any]) -> ShownBattery | None:
    """The facts of `battery.json` as text; None where they are of another kind, as an import's may be."""
    try:
        criteria = [_criterion(one) for one in facts["criteria"]]
        rows = [_row(one) for one in facts["commands"]]
        seconds, push = facts["spec"]["seconds"], facts["spec"]["push"]
        how = f"{seconds:g} s under each command, in C MuJoCo with the model's own solver"
        verdict = f"{'Passed' if facts['passed'] else 'Not passed'}: {how}{', with pushes' if push else ''}."
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        return None
    head = ("command", "falls", *(_NAMES[name] for name in _MEASURED))
    return ShownBattery(verdict, criteria, head, rows)


def _criterion(one: Mapping[str, Any]) -> tuple[str, str, str, str]:
    name, value, bound = one["quantity"], one["value"], one["bound"]
    sign = "≥" if name.endswith("tracking") else "≤"
    if name == "falls":
        return "falls", f"{100 * value:.3g} %", f"{sign} {100 * bound:.3g} %", _held(one)
    return _NAMES.get(name, str(name)), _number(value), f"{sign} {bound:g}", _held(one)


def _held(one: Mapping[str, Any]) -> str:
    return "yes" if one["met"] else "no"


def _row(one: Mapping[str, Any]) -> Sequence[str]:
    command = ", ".join(f"{part:g}" for part in one["command"])
    measured = (_number(one.get(name)) for name in _MEASURED)
    return command, f"{one['falls']:d}/{one['episodes']:d}", *measured


def _number(value: Any) -> str:
    return "–" if value is None else f"{cast('float', value):.2f}"
