"""A robot that follows clips: the share of starts that come to the clips' ends, and the seconds of training.

Each seed is trained under the catalog's tuned settings in a process of its own, which then lets the policy
follow, in C MuJoCo, from 256 starts that are spread over the clips. Cold: nothing is compiled; warm: with
what the cold run left on disk. It needs no service and no network: `python -m bench.imitation --gpu --clip
FILE` where only a training's packages are installed.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from bench.alone import run_alone
from bench.child import ChildFailed, run_child
from bench.summary import Figure, middle

_CHILD = "bench.children.train_imitation"
_TIMEOUT_S = {"gpu": 1500.0, "cpu": 7200.0}
_STARTS, _QUICK_STARTS = 256, 4
_QUICK: dict[str, Any] = {
    "num_timesteps": 2_000,
    "num_envs": 16,
    "unroll_length": 5,
    "batch_size": 16,
    "num_minibatches": 2,
    "num_evals": 0,
    "reset_pool_size": 16,
}
# Up to which errors of the root (m) and of the joints (rad) an episode is close; and which share is to be.
_CLOSE = {"g1": (0.1, 0.15), "humanoid": (0.1, 0.15), "rodent": (0.01, 0.15)}
_SHARE_CLOSE = {"rodent": 0.9}
# On a GPU of the class of an H100, and on two cores: s of training.
_MOST_S = {"gpu": 60.0, "cpu": 3600.0}
_REACHED = 0.95

Answer = dict[str, Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Those of a measurement of imitation."""
    parser.add_argument(
        "--clip",
        type=Path,
        nargs="+",
        required=True,
        metavar="FILE",
        help="of clips: ours, or an NPZ as mjlab's",
    )
    parser.add_argument("--mirrored", action="store_true", help="with the mirror image of each clip")
    parser.add_argument("--body", default="g1", choices=list(_CLOSE), help="of the catalog, by default g1")
    parser.add_argument("--unseen", type=Path, metavar="FILE", help="of clips that are followed besides")
    parser.add_argument(
        "--further",
        type=int,
        default=0,
        metavar="N",
        help="steps that then go on with the unseen clips alone",
    )
    parser.add_argument("--steps", type=int, metavar="N", help="of a training; by default tuned")
    parser.add_argument("--settings", type=json.loads, default={}, metavar="JSON", help="of PPO")
    parser.add_argument("--options", type=json.loads, default={}, metavar="JSON", help="of the task")
    parser.add_argument("--reference", type=json.loads, default={}, metavar="JSON", help="of the reference")
    parser.add_argument("--policies", type=Path, metavar="DIR", help="where the policies are kept")


def measure(arguments: argparse.Namespace, folder: Path) -> Iterator[Figure]:
    """folder: for what the trainings compile."""
    if arguments.further and arguments.unseen is None:
        raise SystemExit("--further goes on with the clips of --unseen: name a file of them, too.")
    seeds = 1 if arguments.quick else arguments.seeds
    answers = [_trained(0, "cold", folder, arguments)]
    answers += [_trained(seed, "warm", folder, arguments) for seed in range(seeds if seeds > 1 else 0)]
    yield from _figures(f"{arguments.body}, {_named(arguments)}", answers, arguments)


def _named(arguments: argparse.Namespace) -> str:
    return "-".join([file.stem for file in arguments.clip] + ["mirrored"] * arguments.mirrored)


def _trained(seed: int, which: str, folder: Path, arguments: argparse.Namespace) -> Answer | str:
    """The child's answer, with its seconds from the process's start; or the reason why there is none."""
    device = "gpu" if arguments.gpu else "cpu"
    steps = {} if arguments.steps is None else {"num_timesteps": arguments.steps}
    keep = None
    if arguments.policies is not None:
        arguments.policies.mkdir(parents=True, exist_ok=True)
        keep = str(arguments.policies.absolute() / f"{arguments.body}-{_named(arguments)}-{seed}.policy")
    request = {
        "body": arguments.body,
        "options": {"task": "imitate", **arguments.options},
        "reference": arguments.reference,
        "clips": [str(file.absolute()) for file in arguments.clip],
        "mirrored": arguments.mirrored,
        "settings": {**(_QUICK if arguments.quick else {}), **arguments.settings, **steps},
        "seed": seed,
        "device": device,
        "cache": str(folder),
        "starts": _QUICK_STARTS if arguments.quick else _STARTS,
        "close": _CLOSE[arguments.body],
        "unseen": str(arguments.unseen.absolute()) if arguments.unseen else None,
        "further": arguments.further,
        "keep": keep,
    }
    try:
        answered = run_child(_CHILD, request, timeout_s=_TIMEOUT_S[device])
    except ChildFailed as failure:
        print(failure)
        return failure.reason
    began = answered["began_at"]
    answered |= {f"{moment}_s": answered[f"{moment}_at"] - began for moment in ("built", "policy", "tested")}
    print(f"seed {seed}, {which}: {_told(answered)}", flush=True)
    return answered


def _told(answered: Answer) -> str:
    """A training and what its policy reached, in lines."""
    steps, training_s = answered["training"][-1]
    lines = [
        f"built after {answered['built_s']:.1f} s, trained after {answered['policy_s']:.1f} s "
        f"({training_s:.1f} s of training, {steps / 1e6:.2f} M steps, {answered['engine']}), tested after "
        f"{answered['tested_s']:.1f} s"
    ]
    rows = {"all": answered["all"], **answered["clips"]}
    if answered["unseen"]:
        rows["all unseen"] = answered["unseen"]
    if answered["learnt"]:
        rows[f"all unseen, after {answered['further_s']:.0f} s with them"] = answered["learnt"]
    for name, row in rows.items():
        lines.append(
            f"  {name}: {row['reached']:.1%} of {row['starts']} starts reached the end, "
            f"{row['close']:.1%} close; "
            f"root {row['root_error']:.3f} m, {row['root_turn_error']:.3f} rad, "
            f"joints {row['joint_error']:.3f} rad, bodies {row['body_error']:.3f} m"
        )
    return "\n".join(lines)


def _figures(what: str, answers: Sequence[Answer | str], arguments: argparse.Namespace) -> Iterator[Figure]:
    """The first answer is of the run with nothing compiled."""
    missing = next((one for one in answers if isinstance(one, str)), "")
    there = [one for one in answers if isinstance(one, dict)]
    device, is_judged = "gpu" if arguments.gpu else "cpu", not arguments.quick
    yield middle(
        f"{what}: share of {_STARTS} starts that come to the end",
        [one["all"]["reached"] for one in there],
        at_least=_REACHED if is_judged else None,
        missing=missing,
    )
    yield middle(
        f"{what}: training",
        [one["training"][-1][1] for one in there],
        "s",
        at_most=_MOST_S[device] if is_judged else None,
        missing=missing,
    )
    yield middle(
        f"{what}: training",
        [one["steps"] / one["training"][-1][1] for one in there],
        "steps/s",
        missing=missing,
    )
    root, joints = _CLOSE[arguments.body]
    yield middle(
        f"{what}: share of starts within {root:g} m and {joints:g} rad",
        [one["all"]["close"] for one in there],
        at_least=_SHARE_CLOSE.get(arguments.body) if is_judged else None,
        missing=missing,
    )
    which = {"unseen": "it has not seen"} if arguments.unseen else {}
    which |= {"learnt": f"it has learnt by {arguments.further} more steps"} if arguments.further else {}
    for row, clips in which.items():
        for share, said in (("reached", "that come to the end"), ("close", "so near")):
            values = [one[row][share] for one in there]
            yield middle(f"{what}: share of starts {said}, of clips that {clips}", values, missing=missing)
    if arguments.further:
        yield middle(f"{what}: their training", [one["further_s"] for one in there], "s", missing=missing)
    for name, unit in (("root_error", "m"), ("root_turn_error", "rad"), ("joint_error", "rad")):
        values = [one["all"][name] for one in there]
        yield middle(f"{what}: {name}, mean over steps", values, unit, missing=missing)
    for state, chosen in (("cold", answers[:1]), ("warm", answers[1:])):
        seconds = [one["policy_s"] for one in chosen if isinstance(one, dict)]
        if seconds:
            yield middle(f"{what}: from the process's start to the policy, {state}", seconds, "s")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.imitation", description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="1: the cold run alone")
    add_arguments(parser)
    run_alone("imitation", parser, measure)


if __name__ == "__main__":
    main()
