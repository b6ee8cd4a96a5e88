"""Physics alone: the engines side by side under each body, in control steps per second.

Bodies move under random controls, and are measured a second of their time after their start, when they touch
what they fall on. Each engine solves as the environment asks of it. Compiling is not counted.
"""

import argparse
from collections.abc import Iterator

from bench.child import ChildFailed, run_child
from bench.summary import Figure, middle
from core.environments import catalog

_BODIES = ("ant", "humanoid", "rodent", "brittle_star", "half_cheetah", "hopper", "walker2d")
_ENGINES = {"cpu": ("compiled", "native", "mjx"), "gpu": ("compiled", "warp", "mjx")}
# The engine beside which `compiled` is put.
_PEERS = {"cpu": "native", "gpu": "warp"}
# How many times as fast as the peer `compiled` is to be.
_TARGETS = {
    "cpu": {"ant": 10.0, "humanoid": 6.0, "rodent": 6.0, "brittle_star": 6.0},
    "gpu": {"brittle_star": 10.0},
}
_NUM_ENVS = {"cpu": 512, "gpu": 4096}
# MJX-JAX is slow on a CPU, and XLA has been seen to stop for good in its program for 512 environments; its
# programs for other bodies than the ant take minutes to compile.
_MJX_ENVS, _MJX_BODIES = 64, ("ant",)
_TIMEOUT_S = 560.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--gpu", action="store_true", help="on the first GPU, not on all cores")
    parser.add_argument("--bodies", nargs="+", default=_BODIES, metavar="BODY")
    parser.add_argument("--engines", nargs="+", metavar="ENGINE", help="one or more of those of the device")
    parser.add_argument("--num-envs", type=int, metavar="N")


def measure(arguments: argparse.Namespace) -> list[Figure]:
    """Each body in a process of its own, which steps it by all engines in turns."""
    device = "gpu" if arguments.gpu else "cpu"
    bodies = ["inverted_pendulum"] if arguments.quick else arguments.bodies
    return [figure for body in bodies for figure in _figures(body, device, arguments)]


def _figures(body: str, device: str, arguments: argparse.Namespace) -> Iterator[Figure]:
    cannot, peer = catalog.find(body).cannot_run, _PEERS[device]
    wanted = arguments.engines or _ENGINES[device]
    most = arguments.num_envs or (16 if arguments.quick else _NUM_ENVS[device])
    num_envs = {engine: most for engine in wanted if engine not in cannot}
    if device == "cpu" and "mjx" in num_envs:
        num_envs["mjx"] = min(most, _MJX_ENVS)
        if body not in _MJX_BODIES:
            del num_envs["mjx"]
    request = {
        "environment": body,
        "device": device,
        "num_envs": num_envs,
        "rounds": 2 if arguments.quick else 7,
        "steps_per_call": 5 if arguments.quick else (20 if device == "cpu" else 100),
    }
    try:
        rates = run_child("bench.children.step", request, timeout_s=_TIMEOUT_S)["rates"]
    except ChildFailed as failure:
        yield Figure(body, None, missing=failure.reason)
        return
    for engine, of_engine in rates.items():
        yield middle(f"{body}, {num_envs[engine]:,} environments, `{engine}`", of_engine, "control steps/s")
    if {"compiled", peer} <= rates.keys():
        pairs = zip(rates["compiled"], rates[peer], strict=True)
        least = None if arguments.quick else _TARGETS[device].get(body)
        yield middle(f"{body}: `compiled` ÷ `{peer}`", [a / b for a, b in pairs], "×", at_least=least)
