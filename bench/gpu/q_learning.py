"""A table that steers a brittle star, on a GPU: our Q-learning against the tutorial notebook's own loop."""

from bench.cpu import q_learning
from bench.cpu.q_learning import CONTROL_STEPS
from bench.measure import requests
from bench.measure.comparison import rate
from bench.measure.result import Figure, Options, Result
from bench.measure.runs import Runs, Work

_NUM_ENVS = 4096
_ROUNDS = 4
_FASTEST, _NATIVE = f"rate-{_NUM_ENVS}", f"rate-{_NUM_ENVS}-native"


def measure(options: Options) -> Result:
    """As on the CPU, on the engine that `auto` picks; and the rate of many environments, also on `native`."""
    device = requests.gpu("gpu_q_learning", options)
    engine = requests.engine_for(device, "brittle_star", 100, quick=options.quick)
    # Two decisions are enough: a round of any length has the same rate of steps.
    num_envs = 4 if options.quick else _NUM_ENVS
    many = {
        "num_envs": num_envs,
        "num_episodes": _ROUNDS * num_envs,
        "decisions_per_episode": 2,
        "num_evals": 0,
    }
    rates = [
        Work(
            name,
            "bench.ours.train_star",
            q_learning.request_of(options, device, by, many, steered=False),
            about_s=200,
            cache="many",
        )
        for name, by in ((_FASTEST, engine), (_NATIVE, "native"))
        if name == _FASTEST or by != engine
    ]
    first, *others = q_learning.works(options, device, engine, () if options.quick else (100,))
    runs = Runs("gpu_q_learning", options)
    runs.make([first, *rates, *others])
    result = q_learning.result(
        "gpu_q_learning", "A brittle star steered by a table, on a GPU", runs, options, 15.0, _FASTEST
    )
    note = (
        f"{_FASTEST}: {_NUM_ENVS:,} environments, {_ROUNDS} episodes of two decisions in each. All 100 "
        "episodes of the others are one round of 100 environments, so there is no curve to draw."
    )
    figures = [
        Figure(
            name=f"training, {_NATIVE}, on the host's cores",
            value=rate(run["training"]),
            unit=CONTROL_STEPS,
        )
        for name, run in runs.done.items()
        if name == _NATIVE
    ]
    return result.model_copy(update={"figures": [*result.figures, *figures], "notes": [note, *result.notes]})
