"""Robots that walk by command: the seconds from a process's start to a passed battery, over several seeds.

Each seed is trained under the catalog's tuned settings in a process of its own, which then tests the policy
in C MuJoCo (docs/battery.md). Cold: nothing is compiled; warm: with what the cold run left on disk. It needs
no service and no network: `python -m bench.robots --gpu` where only a training's packages are installed.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.alone import run_alone
from bench.child import ChildFailed, run_child
from bench.summary import Figure, middle

_CHILD = "bench.children.train_robot"
_TIMEOUT_S = 900.0
_QUICK: dict[str, Any] = {
    "num_timesteps": 2_000,
    "num_envs": 16,
    "unroll_length": 5,
    "batch_size": 16,
    "num_minibatches": 2,
    "num_evals": 1,
    "num_eval_envs": 2,
    "episode_length": 10,
}
# For each command.
_QUICK_STARTS = 2

Answer = dict[str, Any]


@dataclass(frozen=True)
class Robot:
    """Targets of a robot on a GPU, in s: warm in the median and in the worst seed, and cold. bounds: of its
    battery, besides falls and tracking."""

    name: str
    warm_s: float
    worst_s: float
    cold_s: float
    bounds: dict[str, float] = field(default_factory=dict[str, float])


# The bounds are nanoG1's, which were set for a G1: https://github.com/kingjulio8238/nanoG1, RESULTS.md. Its
# action of 1 is 0.25 rad, so that its bound of actions is 0.0525 rad, which is measured and not judged here.
_NANO_G1 = {"action_change": 0.21, "torso_rate": 0.21, "yaw_rate": 0.20, "leg_velocity": 1.22}
_SMOOTHNESS = ("action_change", "target_change", "torso_rate", "yaw_rate", "leg_velocity")
_STRAIGHT_ON = [0.5, 0.0, 0.0]
ROBOTS = {robot.name: robot for robot in (Robot("g1", 25, 40, 45, _NANO_G1), Robot("go1", 12, 12 * 1.6, 30))}
# Seconds of training alone that others publish for a G1 by command, with their machine and their source.
_PUBLISHED = {
    "nanoG1, 75 M steps on an RTX PRO 6000 (its RESULTS.md)": 58.9,
    "mjlab 1.6.0, 295 M steps on an L4 (huggingface.co/Ethgar/toolbot-g1-velocity)": 3967.5,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Those that only this part has."""
    parser.add_argument("--steps", type=int, metavar="N", help="of a robot's training; by default tuned")
    parser.add_argument(
        "--settings", type=json.loads, default={}, metavar="JSON", help="of PPO, for the robots"
    )
    parser.add_argument("--options", type=json.loads, default={}, metavar="JSON", help="of the robots' tasks")
    parser.add_argument("--policies", type=Path, metavar="DIR", help="where the robots' policies are kept")


def measure(arguments: argparse.Namespace, folder: Path) -> Iterator[Figure]:
    """folder: for what the trainings compile. The bodies are robots of this part; by default all."""
    asked = arguments.bodies or list(ROBOTS)
    for robot in (ROBOTS[name] for name in asked if name in ROBOTS):
        seeds = 1 if arguments.quick else arguments.seeds
        answers = [_trained(robot, 0, "cold", folder, arguments)]
        answers += [_trained(robot, seed, "warm", folder, arguments) for seed in range(seeds)]
        yield from _figures(robot, answers, arguments.gpu and not arguments.quick)
    if "g1" in asked:
        yield from (
            Figure(f"training alone, published: {what}", seconds, "s") for what, seconds in _PUBLISHED.items()
        )


def _trained(
    robot: Robot, seed: int, which: str, folder: Path, arguments: argparse.Namespace
) -> Answer | str:
    """The child's answer, with its seconds from the process's start; or the reason why there is none."""
    steps = {} if arguments.steps is None else {"num_timesteps": arguments.steps}
    keep = None
    if arguments.policies is not None:
        arguments.policies.mkdir(parents=True, exist_ok=True)
        keep = str(arguments.policies.absolute() / f"{robot.name}-{seed}.policy")
    cache = folder / f"{robot.name}-robot"
    cache.mkdir(exist_ok=True)
    request = {
        "robot": robot.name,
        "options": arguments.options,
        "settings": {**(_QUICK if arguments.quick else {}), **arguments.settings, **steps},
        "seed": seed,
        "device": "gpu" if arguments.gpu else "cpu",
        "cache": str(cache),
        "battery": {
            "bounds": robot.bounds,
            **({"starts": _QUICK_STARTS, "seconds": 2} if arguments.quick else {}),
        },
        "keep": keep,
    }
    try:
        answered = run_child(_CHILD, request, timeout_s=_TIMEOUT_S)
    except ChildFailed as failure:
        print(failure)
        return failure.reason
    began = answered["began_at"]
    answered |= {f"{moment}_s": answered[f"{moment}_at"] - began for moment in ("built", "policy", "tested")}
    print(f"{robot.name}, seed {seed}, {which}: {_told(answered)}", flush=True)
    return answered


def _told(answered: Answer) -> str:
    """A training and its battery, in lines."""
    steps, training_s = answered["training"][-1]
    battery = answered["battery"]
    lines = [
        f"built after {answered['built_s']:.1f} s, trained after {answered['policy_s']:.1f} s "
        f"({training_s:.1f} s of training, {steps / 1e6:.1f} M steps), tested after "
        f"{answered['tested_s']:.1f} s (battery {battery['took_s']:.1f} s): "
        f"{'passed' if battery['passed'] else 'NOT PASSED'}"
    ]
    for one in battery["criteria"]:
        value = "nothing" if one["value"] is None else f"{one['value']:.3f}"
        lines.append(f"  {one['quantity']} {value}, bound {one['bound']:g}{'' if one['met'] else ': MISSED'}")
    for row in battery["commands"]:
        smooth = (row[name] for name in _SMOOTHNESS)
        lines.append(
            f"  {row['command']}: {row['falls']} of {row['episodes']} fell, tracking "
            f"{row['linear_tracking']:.2f} and {row['angular_tracking']:.2f}; smooth "
            + " ".join("–" if value is None else f"{value:.2f}" for value in smooth)
        )
    return "\n".join(lines)


def _figures(robot: Robot, answers: Sequence[Answer | str], has_targets: bool) -> Iterator[Figure]:
    """The first answer is of the run with nothing compiled."""
    there = [one for one in answers if isinstance(one, dict)]
    missing = next((one for one in answers if isinstance(one, str)), "a battery was not passed")
    cold, warm = answers[0], [one for one in answers[1:] if isinstance(one, dict)]
    name, number = robot.name, len(answers) - 1
    passed = [one for one in warm if one["battery"]["passed"]]
    complete = passed if len(passed) == number else []
    yield Figure(f"{name}: seeds of {number} that passed the battery", len(passed), at_least=number)
    yield middle(
        f"{name}, warm, from the process's start to a passed battery",
        [one["tested_s"] for one in complete],
        "s",
        at_most=robot.warm_s if has_targets else None,
        missing=missing,
    )
    if complete:
        worst = max(one["tested_s"] for one in complete)
        yield Figure(
            f"{name}, warm, the same, worst seed", worst, "s", at_most=robot.worst_s if has_targets else None
        )
    yield middle(f"{name}, warm, to the policy", [one["policy_s"] for one in warm], "s", missing=missing)
    if isinstance(cold, dict):
        yield Figure(f"{name}, cold, to the policy", cold["policy_s"], "s")
        is_passed = cold["battery"]["passed"]
        yield Figure(
            f"{name}, cold, to a passed battery",
            cold["tested_s"] if is_passed else None,
            "s",
            at_most=robot.cold_s if has_targets else None,
            missing="not passed",
        )
    yield middle(f"{name}, training alone", [one["training"][-1][1] for one in warm], "s", missing=missing)
    yield middle(f"{name}, training", [_rate(one["training"]) for one in warm], "steps/s", missing=missing)
    yield middle(f"{name}, battery", [one["battery"]["took_s"] for one in warm], "s", missing=missing)
    straight = [row for one in warm for row in one["battery"]["commands"] if row["command"] == _STRAIGHT_ON]
    changes = [row["target_change"] for row in straight if row["target_change"] is not None]
    yield middle(f"{name}, battery, target_change (nanoG1: 0.0525)", changes, "rad", missing=missing)
    for quantity in [one["quantity"] for one in there[0]["battery"]["criteria"]] if there else []:
        found = [_criterion(one, quantity) for one in warm]
        values = [one["value"] for one in found if one["value"] is not None]
        bound = found[0]["bound"] if found else None
        least, most = (bound, None) if quantity.endswith("tracking") else (None, bound)
        yield middle(f"{name}, battery, {quantity}", values, at_least=least, at_most=most, missing=missing)


def _criterion(answered: Answer, quantity: str) -> Answer:
    return next(one for one in answered["battery"]["criteria"] if one["quantity"] == quantity)


def _rate(training: Sequence[Sequence[float]]) -> float:
    steps, seconds = training[-1]
    return steps / max(seconds, 1e-9)


def main() -> None:
    """The command line where a bench's other parts lack their packages."""
    parser = argparse.ArgumentParser(prog="python -m bench.robots", description=__doc__)
    parser.add_argument("--bodies", nargs="+", choices=list(ROBOTS), metavar="ROBOT", help="by default all")
    parser.add_argument("--seeds", type=int, default=5, metavar="N")
    add_arguments(parser)
    run_alone("robots", parser, measure)


if __name__ == "__main__":
    main()
