"""A job's battery in words: the test of a policy that follows commands or clips (docs/battery.md)."""

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
    "reached": "to the end",
    "root_error": "root, m",
    "joint_error": "joints, rad",
}
_OF_COMMANDS = (
    "Velocity and turning: means of exp(-e² / 0.25). Root mean squares: the change of the legs' actions, and "
    "of their targets in rad; the torso's roll and pitch, its yaw, and the legs' joints, in rad/s."
)
_OF_THE_CLIPS = "Root and joints: mean errors over the steps of a clip's episodes, up to where each ended."
_OF_CLIPS = ("root_error", "joint_error")
_MEASURED = tuple(name for name in _NAMES if name not in ("falls", "reached", *_OF_CLIPS))
_SHARES = ("falls", "reached")


@dataclass(frozen=True)
class ShownBattery:
    """verdict: a sentence. criteria: quantity, value, bound, whether it holds. rows: one for each command, or
    for each clip. legend: what the numbers of the rows are."""

    verdict: str
    criteria: Sequence[tuple[str, str, str, str]]
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    legend: str


def shown_battery(facts: Mapping[str, Any]) -> ShownBattery | None:
    """The facts of `battery.json` as text; None where they are of another kind, as an import's may be."""
    try:
        criteria = [_criterion(one) for one in facts["criteria"]]
        rows = [_row(one) for one in facts["commands"]]
        clips = [_clip(one) for one in facts.get("clips", [])]
        seconds, push = facts["spec"]["seconds"], facts["spec"]["push"]
        what = "each clip to its end" if clips else f"{seconds:g} s under each command"
        how = f"{what}, in C MuJoCo with the model's own solver"
        verdict = f"{'Passed' if facts['passed'] else 'Not passed'}: {how}{', with pushes' if push else ''}."
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        return None
    if clips:
        head = ("clip", _NAMES["reached"], *(_NAMES[name] for name in _OF_CLIPS))
        return ShownBattery(verdict, criteria, head, clips, _OF_THE_CLIPS)
    head = ("command", "falls", *(_NAMES[name] for name in _MEASURED))
    return ShownBattery(verdict, criteria, head, rows, _OF_COMMANDS)


def _criterion(one: Mapping[str, Any]) -> tuple[str, str, str, str]:
    name, value, bound = one["quantity"], one["value"], one["bound"]
    sign = "≥" if name.endswith("tracking") or name == "reached" else "≤"
    if name in _SHARES:
        return _NAMES[name], f"{100 * value:.3g} %", f"{sign} {100 * bound:.3g} %", _held(one)
    shown = _error(value) if name in _OF_CLIPS else _number(value)
    return _NAMES.get(name, str(name)), shown, f"{sign} {bound:g}", _held(one)


def _held(one: Mapping[str, Any]) -> str:
    return "yes" if one["met"] else "no"


def _row(one: Mapping[str, Any]) -> Sequence[str]:
    command = ", ".join(f"{part:g}" for part in one["command"])
    measured = (_number(one.get(name)) for name in _MEASURED)
    return command, f"{one['falls']:d}/{one['episodes']:d}", *measured


def _clip(one: Mapping[str, Any]) -> Sequence[str]:
    reached = round(one["reached"] * one["episodes"])
    return str(one["clip"]), f"{reached:d}/{one['episodes']:d}", *(_error(one[name]) for name in _OF_CLIPS)


def _number(value: Any) -> str:
    return "–" if value is None else f"{cast('float', value):.2f}"


def _error(value: Any) -> str:
    """To the millimetre: a rat's bound may be a centimetre."""
    return "–" if value is None else f"{cast('float', value):.3f}"
