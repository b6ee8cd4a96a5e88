"""Compares the estimate of a run's least memory with the memory that the run takes."""

from typing import Any

from bench.measure.child import ChildFailed, run_child
from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result, at_most
from core.algorithms.memory import shown

_TIMEOUT_S = 1200.0
_Q: dict[str, Any] = {
    "kind": "q_learning",
    "state_discretizer": {"kind": "arm_role"},
    "action_set": {"kind": "arm_roles"},
    "num_evals": 0,
}
_CPG = {"control": "cpg"}


def _ppo(num_envs: int, batch_size: int, minibatches: int, unroll: int) -> dict[str, Any]:
    return {
        "kind": "ppo",
        "num_envs": num_envs,
        "batch_size": batch_size,
        "num_minibatches": minibatches,
        "num_updates_per_batch": 1,
        "unroll_length": unroll,
        "num_timesteps": 3 * batch_size * minibatches * unroll,
        "num_evals": 0,
    }


_FEW = _ppo(64, 64, 2, 5)
_STAR = {**_Q, "num_envs": 8, "num_episodes": 24, "decisions_per_episode": 5}
# name: environment, options, algorithm.
Case = tuple[str, dict[str, Any], dict[str, Any]]
_ON_A_CPU: dict[str, Case] = {
    "ant, few": ("ant", {}, _FEW),
    "ant, long unrolls": ("ant", {}, _ppo(64, 64, 16, 200)),
    "ant, many environments": ("ant", {}, _ppo(8192, 1024, 8, 10)),
    "ant, large networks": (
        "ant",
        {},
        {**_FEW, "policy_hidden_layer_sizes": [4096, 4096], "value_hidden_layer_sizes": [4096, 4096]},
    ),
    "humanoid, few": ("humanoid", {}, _FEW),
    "humanoid, many environments": ("humanoid", {}, _ppo(2048, 1024, 8, 10)),
    "rodent, few": ("rodent", {}, _FEW),
    "rodent, many environments": ("rodent", {}, _ppo(1024, 512, 4, 10)),
    "star, Q-learning, few": ("brittle_star", _CPG, _STAR),
    "star, Q-learning, replay": (
        "brittle_star",
        _CPG,
        {**_STAR, "replay": {"buffer_size": 10_000_000}},
    ),
}
_ON_A_GPU: dict[str, Case] = {
    **_ON_A_CPU,
    "ant, long unrolls": ("ant", {}, _ppo(2048, 2048, 32, 200)),
    "ant, many environments": ("ant", {}, _ppo(16384, 4096, 32, 20)),
    "humanoid, many environments": ("humanoid", {}, _ppo(8192, 2048, 32, 20)),
    "rodent, many environments": ("rodent", {}, _ppo(4096, 1024, 32, 20)),
}
_QUICK = ("ant, few", "ant, long unrolls")


def measure(options: Options) -> Result:
    """Start each run in its own process, up to its first report of progress."""
    device = "gpu" if options.gpu else "cpu"
    cases = _ON_A_GPU if options.gpu else _ON_A_CPU
    if options.quick:
        cases = {name: case for name, case in cases.items() if name in _QUICK}
    machine = this_machine()
    rows: list[dict[str, Any]] = []
    figures: list[Figure] = []
    for name, (environment, environment_options, algorithm) in cases.items():
        request = {
            "environment": environment,
            "options": environment_options,
            "algorithm": algorithm,
            "engine": "auto",
            "device": device,
        }
        figure = f"{name}: estimate ÷ peak"
        try:
            found = run_child("bench.ours.memory_run", request, timeout_s=_TIMEOUT_S)
        except ChildFailed as failed:
            print(f"{name}: {failed.reason}", flush=True)
            figures.append(Figure(name=figure, value=None, unit="%", missing=failed.reason))
            continue
        share = found["least_bytes"] / found["taken_bytes"]
        print(
            f"{name} ({found['engine']}): at least {shown(found['least_bytes'])} by the estimate, "
            f"{shown(found['taken_bytes'])} at the peak: {100 * share:.1f} %",
            flush=True,
        )
        figures.append(Figure(name=figure, value=100 * share, unit="%", target=at_most(100)))
        rows.append({"name": name, **{key: value for key, value in found.items() if key != "began_at"}})
    return Result(
        name="memory",
        title="Memory",
        command="./run bench memory" + (" --gpu" if options.gpu else ""),
        quick=options.quick,
        machine=machine,
        figures=figures,
        rows=rows,
        notes=[
            "Each figure is the estimate, by which a job that cannot fit is refused, over the peak of the "
            "run up to its first updates. Above 100 %, it would refuse a job that fits. "
            + (
                "The peak is JAX's count of the device's memory in use; Warp's own buffers are not in it."
                if options.gpu
                else "The peak is the growth of the process after its programs were compiled, plus the state "
                "that existed by then. A small run reuses pages that compiling left behind, so its measured "
                "peak is too low."
            ),
        ],
    )
