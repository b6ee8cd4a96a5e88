"""The ant over gaps, trained in one corridor, in many, and by a curriculum; tried where it never was."""

from typing import Any

from bench.measure import comparison, requests
from bench.measure.comparison import UNIT, rate
from bench.measure.result import Figure, Options, Result, Table
from bench.measure.runs import Run, Runs, Work
from core.environments.info import Device

_STEPS: dict[Device, int] = {"cpu": 3_000_000, "gpu": 150_000_000}
_NUM_LAYOUTS = 64
# Far from the training's seeds, which are 123456 to 123519.
_UNSEEN_SEED = 10_000_000
# 40 s: enough for whoever walks at 1 m/s.
_EPISODES, _EPISODE_STEPS = 128, 4000
_SEES: dict[str, Any] = {"num_next_obstacles": 2}
_WHERE = {"own": "the layouts that it was trained in", "unseen": "layouts never seen"}


def measure(options: Options) -> Result:
    """On the CPU; see `measured`."""
    return measured(options, "layouts", "cpu")


def measured(options: Options, name: str, device: Device) -> Result:
    """Three runs of each seed, one after the other, each tried in its own layouts and in others."""
    few = {"num_envs": 8, "batch_size": 8, "num_minibatches": 2} if options.quick else {}
    given = requests.settings(device, "corridor", Options(out=options.out), num_evals=0, **few)
    if options.quick:
        given = requests.whole_updates(device, "corridor", given, 3)
    else:
        given = {**given, "num_timesteps": _STEPS[device]}
    runs = Runs(name, options)
    runs.make(
        Work(
            f"{trained}-{seed}",
            "bench.ours.train_layouts",
            request,
            timeout_s=1500,
            about_s=180,
            cache=trained,
        )
        for seed in range(options.seeds or 1)
        for trained, request in _requests(device, given, options, seed).items()
    )
    return Result(
        name=name,
        title=f"One corridor, many, and a curriculum, on a {device.upper()}",
        command=f"./run bench {name}",
        quick=options.quick,
        machine=runs.where(),
        figures=[figure for trained, run in runs.done.items() for figure in _figures(trained, run)],
        table=_table(runs.done),
        rows=[comparison.row(trained, run, **_tried(run)) for trained, run in runs.done.items()],
        notes=[*_notes(given), *runs.notes()],
        unfinished=runs.left,
    )


def _requests(
    device: Device, given: dict[str, Any], options: Options, seed: int
) -> dict[str, dict[str, Any]]:
    """By what the ant is trained in."""
    budget = requests.resolved(device, "corridor", given).num_timesteps
    many = {**_SEES, "num_layouts": 2 if options.quick else _NUM_LAYOUTS}
    curriculum = {"start": {"gap_length": [0.0, 0.05]}, "over_steps": budget // 2}
    engine = requests.engine(device, "corridor", given, quick=options.quick)
    request = {
        **requests.ours(device, "corridor", engine, given, seed=seed),
        "tried": {"own": {}, "unseen": {"arena_seed": _UNSEEN_SEED, "num_layouts": many["num_layouts"]}},
        "episodes": 4 if options.quick else _EPISODES,
        "steps": 20 if options.quick else _EPISODE_STEPS,
    }
    trained = {"one": _SEES, "many": many, "curriculum": {**many, "curriculum": curriculum}}
    return {name: {**request, "options": own} for name, own in trained.items()}


def _figures(trained: str, run: Run) -> list[Figure]:
    tried = run["tried"]
    return [
        Figure(name=f"{trained}: past the last gap, unseen", value=100 * tried["unseen"]["passed"], unit="%"),
        Figure(
            name=f"{trained}: past the last gap, own − unseen",
            value=100 * (tried["own"]["passed"] - tried["unseen"]["passed"]),
            unit="points",
        ),
        Figure(name=f"{trained}: training", value=rate(run["training"]), unit=UNIT),
    ]


def _tried(run: Run) -> dict[str, float]:
    return {f"{where}_{name}": value for where, one in run["tried"].items() for name, value in one.items()}


def _table(done: dict[str, Run]) -> Table | None:
    rows = [
        [
            trained,
            where,
            f"{one['speed']:.2f}",
            f"{100 * one['passed']:.0f} %",
            f"{100 * one['way']:.0f} %",
            f"{100 * one['fell']:.0f} %",
        ]
        for trained, run in done.items()
        for name, where in _WHERE.items()
        for one in [run["tried"][name]]
    ]
    headings = ["trained in", "tried in", "m/s", "past the last gap", "of the way", "fell"]
    return Table(headings=headings, rows=rows) if rows else None


def _notes(given: dict[str, Any]) -> list[str]:
    longest = _EPISODE_STEPS * 0.01
    return [
        f"{given['num_timesteps']:,} steps of PPO under the tuned settings; the ant is shown the next two "
        f"gaps. `one`: the corridor of arena_seed 123456; `many`: {_NUM_LAYOUTS} layouts from there on; "
        "`curriculum`: the same, with gaps that grow from 0 to 0.05 m to the options' 0.05 to 0.2 m over the "
        "first half. A run's name ends with its seed.",
        f"Each is tried in {_EPISODES} episodes of at most {longest:.0f} s, without noise, in its own "
        f"layouts and in {_NUM_LAYOUTS} from arena_seed {_UNSEEN_SEED:,} on; a trial ends past the last gap.",
    ]
