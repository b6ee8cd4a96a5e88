"""The corridor on a GPU: ours on the engine that `auto` picks, against dm_control's model under MJX-JAX."""

from statistics import median

from bench.measure import comparison, requests
from bench.measure.comparison import UNIT, rate
from bench.measure.result import Figure, Options, Result, at_least
from bench.measure.runs import Runs, Work

_BODY = "corridor"
_UPDATES = 12
_COMPOSED_ENVS = 64
_N_FRAMES = 5
_TIMEOUT_S = 1500.0


def measure(options: Options) -> Result:
    """Ours in training and without networks; then the composed model, with a time limit."""
    device = requests.gpu("gpu_corridor", options)
    small = {"num_envs": 8, "batch_size": 8, "num_minibatches": 2} if options.quick else {}
    given = requests.settings(device, _BODY, Options(out=options.out), num_evals=0, **small)
    engine = requests.engine(device, _BODY, given, quick=options.quick)
    whole = requests.whole_updates(device, _BODY, given, 4 if options.quick else _UPDATES)
    ours = {**requests.ours(device, _BODY, engine, whole), "physics_s": 0.1 if options.quick else 5.0}
    composed = {
        "options": {"walker": "ant", "arena": "gaps"},
        "num_envs": 2 if options.quick else _COMPOSED_ENVS,
        "steps": 1,
        "n_frames": _N_FRAMES,
        "device": device,
    }
    works = [Work("ours", "bench.ours.run_engine", ours, timeout_s=_TIMEOUT_S, about_s=60, cache="ours")]
    if not options.quick:  # Its compilation takes minutes.
        works += [Work("composed", "bench.peers.step_composed", composed, timeout_s=_TIMEOUT_S, about_s=240)]
    runs = Runs("gpu_corridor", options)
    runs.make_together(works, at_once=2, in_turns=True)
    return Result(
        name="gpu_corridor",
        title="The ant in its corridor with gaps, on a GPU",
        command="./run bench gpu_corridor",
        quick=options.quick,
        machine=runs.where(),
        figures=_figures(runs, engine),
        rows=[comparison.row(name, run) for name, run in runs.done.items() if name == "ours"],
        notes=[
            f"Ours: the tuned settings, {_UPDATES} updates; then the same environments without networks, "
            "under a random action in each control step, which is five physics steps of one environment. In "
            "training, too, control steps are counted, not the policy's actions.",
            f"Composed: {_COMPOSED_ENVS} environments of the model as dm_control composes it, physics alone "
            "under random actions; only what MJX lacks is left out of it (the noslip solver and some "
            "sensors).",
            *runs.notes(),
        ],
        unfinished=runs.left,
    )


def _figures(runs: Runs, engine: str) -> list[Figure]:
    figures = list[Figure]()
    ours, composed = runs.done.get("ours"), runs.done.get("composed")
    if ours:
        figures += [
            Figure(
                name=f"environments alone, `{engine}`", value=median(ours["physics"]), unit="control steps/s"
            ),
            Figure(name=f"training, `{engine}`", value=rate(ours["training"]), unit=UNIT),
        ]
    if composed:
        name = f"as composed, MJX-JAX ({composed['contacts']} contacts, {composed['rows']} rows)"
        figures.append(Figure(name=name, value=median(composed["rates"]), unit="control steps/s"))
    elif why := runs.failed.get("composed"):
        figures.append(Figure(name="as composed, MJX-JAX", value=None, unit="", missing=why))
    if ours and composed:
        figures += comparison.quotient(
            "environments alone, ours ÷ as composed",
            median(ours["physics"]),
            median(composed["rates"]),
            at_least(20),
        )
    return figures
