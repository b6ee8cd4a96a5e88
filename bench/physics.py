"""Physics alone: the engines side by side under each body, in control steps per second.

Bodies move under random controls, and are measured a second of their time after their start, when they touch
what they fall on. Each engine solves as the environment asks of it. Robots as their authors publish them
(`a2_whole`; `robots` are all) and dm_control's humanoid (`humanoid_whole`) make 4 substeps, and solve with 4
iterations at most and 8 steps of line search (`native`: until it has converged). The rate is without the
making of code, whose time is measured with nothing kept from before.
"""

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from bench.bodies import PUBLISHED, ROBOTS
from bench.child import ChildFailed, run_child
from bench.summary import Figure, middle

_BODIES = ("ant", "humanoid", "rodent", "brittle_star", "half_cheetah", "hopper", "walker2d")
_ENGINES = {"cpu": ("compiled", "native", "mjx"), "gpu": ("compiled", "warp", "mjx")}
# The engine beside which `compiled` is put.
_PEERS = {"cpu": "native", "gpu": "warp"}
# How many times as fast as the peer `compiled` is to be.
_TARGETS = {
    "cpu": {"ant": 10.0, "humanoid": 6.0, "rodent": 6.0, "brittle_star": 6.0, **dict.fromkeys(ROBOTS, 5.0)},
    "gpu": {"brittle_star": 10.0, "rodent": 2.0, "humanoid_whole": 2.0, **dict.fromkeys(ROBOTS, 3.0)},
}
_NUM_ENVS = {"cpu": 512, "gpu": 4096}
_OTHER_NUM_ENVS = {"cpu": {}, "gpu": {"g1_whole": 8192, "rodent": 2048}}
# MJX-JAX is slow on a CPU, and XLA has been seen to stop for good in its program for 512 environments; its
# programs for other bodies than the ant take minutes to compile.
_MJX_ENVS, _MJX_BODIES = 64, ("ant",)
_TIMEOUT_S = 900.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--gpu", action="store_true", help="on the first GPU, not on all cores")
    parser.add_argument(
        "--bodies", nargs="+", default=_BODIES, metavar="BODY", help="or an MJCF file; `robots` are eleven"
    )
    parser.add_argument("--kept", type=Path, metavar="DIR", help="where bench.bodies has kept the bodies")
    parser.add_argument("--engines", nargs="+", metavar="ENGINE", help="one or more of those of the device")
    parser.add_argument("--num-envs", type=int, metavar="N")
    parser.add_argument("--rounds", type=int, default=7, metavar="N")
    parser.add_argument("--limit", type=float, default=300.0, metavar="S", help="for an engine's code")
    parser.add_argument(
        "--at-once",
        type=int,
        default=1,
        metavar="N",
        help="bodies whose code is made at once; measured alone",
    )


def measure(arguments: argparse.Namespace) -> list[Figure]:
    """Each body in a process of its own, which steps it by all engines in turns."""
    bodies = ["inverted_pendulum"] if arguments.quick else _named(arguments.bodies)
    with (
        tempfile.NamedTemporaryFile(prefix="gaitway-bench-") as turn,
        ThreadPoolExecutor(arguments.at_once) as pool,
    ):
        waiting = [pool.submit(_figures, body, turn.name, arguments) for body in bodies]
        return [figure for one in waiting for figure in one.result()]


def _named(bodies: Sequence[str]) -> list[str]:
    return [one for name in bodies for one in (ROBOTS if name == "robots" else [name])]


def _figures(body: str, turn: str, arguments: argparse.Namespace) -> list[Figure]:
    device = "gpu" if arguments.gpu else "cpu"
    num_envs = _num_envs(body, device, arguments)
    request = {
        "body": body,
        "kept": str(arguments.kept) if arguments.kept else None,
        "device": device,
        "num_envs": num_envs,
        "rounds": 2 if arguments.quick else arguments.rounds,
        "round_s": 0.0 if arguments.quick else 0.3,
        "steps_per_call": 5 if arguments.quick else (20 if device == "cpu" else 50),
        "limit_s": arguments.limit,
        "turn": turn,
    }
    try:
        told = run_child("bench.children.step", request, timeout_s=_TIMEOUT_S)
    except ChildFailed as failure:
        print(failure)
        return [Figure(body, None, missing=failure.reason)]
    print(f"{body}: {told}", flush=True)
    least = None if arguments.quick else _TARGETS[device].get(body)
    return list(_told(body, num_envs, told, _PEERS[device], least))


def _told(
    body: str, num_envs: dict[str, int], told: dict[str, Any], peer: str, least: float | None
) -> Iterator[Figure]:
    rates = told["rates"]
    for engine, number in num_envs.items():
        sound = told["sound"].get(engine, 1.0)
        broken = "" if sound == 1.0 else f", {1 - sound:.2%} not finite"
        name = f"{body}, {number:,} environments, `{engine}`{broken}"
        yield middle(name, rates.get(engine, []), "control steps/s", missing=told["missing"].get(engine, ""))
    if "compiled" in told["ready_s"]:
        yield Figure(f"{body}: until `compiled` is ready", told["ready_s"]["compiled"], "s")
    if "compiled" in num_envs and peer in rates:
        pairs = zip(rates.get("compiled", []), rates[peer], strict=False)
        yield middle(f"{body}: `compiled` ÷ `{peer}`", [a / b for a, b in pairs], "×", at_least=least)


def _num_envs(body: str, device: str, arguments: argparse.Namespace) -> dict[str, int]:
    """By engine."""
    of_body = _OTHER_NUM_ENVS[device].get(body, _NUM_ENVS[device])
    most = arguments.num_envs or (16 if arguments.quick else of_body)
    found = dict.fromkeys(arguments.engines or _ENGINES[device], most)
    if "mjx" in found and arguments.engines is None and (device == "cpu" or body in PUBLISHED):
        if body in _MJX_BODIES:
            found["mjx"] = min(most, _MJX_ENVS)
        else:
            del found["mjx"]
    # What may not be ready in time comes last: it does not disturb the others.
    return {engine: found[engine] for engine in sorted(found, key=lambda one: one == "compiled")}
