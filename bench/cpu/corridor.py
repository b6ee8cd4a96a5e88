"""The corridor on the CPU: the ant's control steps per second, in training and without networks."""

from statistics import median

from bench.measure import comparison, requests
from bench.measure.comparison import UNIT, rate
from bench.measure.result import Figure, Options, Result, at_least
from bench.measure.runs import Runs, Work

_BODY, _ENGINE = "corridor", "native"
_UPDATES = 4


def measure(options: Options) -> Result:
    """A few updates under the tuned settings, then environments alone, in a separate process."""
    small = {"num_envs": 8, "batch_size": 8, "num_minibatches": 2} if options.quick else {}
    given = requests.settings("cpu", _BODY, Options(out=options.out), num_evals=0, **small)
    whole = requests.whole_updates("cpu", _BODY, given, _UPDATES)
    request = {
        **requests.ours("cpu", _BODY, _ENGINE, whole),
        "physics_s": 0.1 if options.quick else 20.0,
        "cache": None,
    }
    runs = Runs("corridor", options)
    runs.make([Work("ours", "bench.ours.run_engine", request, timeout_s=300)])
    figures = list[Figure]()
    if run := runs.done.get("ours"):
        figures = [
            Figure(
                name="environments alone, random actions",
                value=median(run["physics"]),
                unit="control steps/s",
                low=min(run["physics"][1:]),
                high=max(run["physics"]),
                target=at_least(10_000),
            ),
            Figure(name="training", value=rate(run["training"]), unit=UNIT),
        ]
    return Result(
        name="corridor",
        title="The ant in its corridor with gaps, on the CPU",
        command="./run bench corridor",
        quick=options.quick,
        machine=runs.where(),
        figures=figures,
        rows=[
            comparison.row(name, run, control_steps_per_second=median(run["physics"]))
            for name, run in runs.done.items()
        ],
        notes=[
            "The environment's default options: 40 m with gaps, five physics steps to a control step, Newton "
            "to convergence. A control step is that of one environment, with its observation, reward and, "
            "after a fall, a new start; without networks each has an action of its own.",
            *runs.notes(),
        ],
        unfinished=runs.left,
    )
