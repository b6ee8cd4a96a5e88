"""Learning on a GPU: every walking body with its whole budget, by our loop and Brax's on the same engine."""

from bench.measure import comparison, requests
from bench.measure.requests import Settings
from bench.measure.result import Figure, Options, Picture, Result, Table, at_least
from bench.measure.runs import Run, Runs, Work
from bench.measure.statistics import Estimate
from core.environments.info import Device

_BODIES = ("ant", "half_cheetah", "hopper", "walker2d", "humanoid")
_NUM_EVALS = 6
# The card is shared: equal steps are compared here, not equal times.
_AT_ONCE = 3
# With the card shared: 190 s of an ant or a hopper, 270 s of a half cheetah.
_ABOUT_S = 230.0
_WHO = {"ours": "ours", "brax": "Brax, same engine"}


def measure(options: Options) -> Result:
    """One seed of each trainer and body, or `seeds` of them; the first seeds of all bodies come first."""
    device, num_seeds = requests.gpu("gpu_bodies", options), options.seeds or 1
    bodies = ("inverted_pendulum",) if options.quick else _BODIES
    runs = Runs("gpu_bodies", options)
    runs.make_together(
        (work for seed in range(num_seeds) for body in bodies for work in _pair(device, body, seed, options)),
        at_once=1 if options.quick else _AT_ONCE,
    )
    found = {
        body: {
            who: [run for seed in range(num_seeds) if (run := runs.done.get(f"{who}-{body}-{seed}"))]
            for who in _WHO
        }
        for body in bodies
    }
    complete = {body: of_both for body, of_both in found.items() if all(of_both.values())}
    return Result(
        name="gpu_bodies",
        title="Learning on a GPU, every walking body",
        command=f"./run bench gpu_bodies{f' --seeds {num_seeds}' if num_seeds > 1 else ''}",
        quick=options.quick,
        machine=runs.where(),
        figures=[figure for body, of_both in complete.items() for figure in _figures(body, of_both)],
        table=_table(complete) if complete else None,
        rows=[comparison.row(name, run) for name, run in runs.done.items()],
        notes=[*_notes(num_seeds), *runs.notes()],
        pictures=_pictures(complete),
        unfinished=runs.left,
    )


def _pair(device: Device, body: str, seed: int, options: Options) -> list[Work]:
    given = _settings(device, body, options)
    engine = requests.engine(device, body, given, quick=options.quick)
    ours = requests.ours(device, body, engine, given, seed=seed)
    brax = requests.brax(device, body, engine, given, seed=seed, epochs=_NUM_EVALS - 1)
    # One cache for both: they share no programs, but all of Warp's kernels.
    return [
        Work(f"ours-{body}-{seed}", "bench.ours.train_ppo", ours, about_s=_ABOUT_S, cache="both"),
        Work(f"brax-{body}-{seed}", "bench.peers.train_brax", brax, about_s=_ABOUT_S, cache="both"),
    ]


def _settings(device: Device, body: str, options: Options) -> Settings:
    few = {} if options.quick else {"num_eval_envs": 128}
    given = requests.settings(device, body, options, num_evals=_NUM_EVALS, reset_pool_size=0, **few)
    if options.quick:
        return requests.whole_updates(device, body, given, 2 * (_NUM_EVALS - 1))
    return requests.equal_budget(device, body, given, epochs=_NUM_EVALS - 1)


def _figures(body: str, of_both: dict[str, list[Run]]) -> list[Figure]:
    """The figures with targets: the returns, in standard errors if there are several seeds."""
    ours, brax = comparison.returns(of_both["ours"]), comparison.returns(of_both["brax"])
    compared = comparison.versus(
        f"{body}: our return − Brax's", of_both["ours"], of_both["brax"]
    ) or comparison.quotient(f"{body}: our return ÷ Brax's, one seed", ours.mean, brax.mean, at_least(1))
    return compared


def _table(complete: dict[str, dict[str, list[Run]]]) -> Table:
    rows = [
        [
            body,
            f"{of_both['ours'][0]['training'][-1][0]:,}",
            *(_return(comparison.returns(of_both[who])) for who in _WHO),
        ]
        for body, of_both in complete.items()
    ]
    return Table(headings=["Body", "Steps", "Return, ours", "Return, Brax"], rows=rows)


def _return(seeds: Estimate) -> str:
    return f"{seeds.mean:,.0f}" + ("" if seeds.error is None else f" ± {seeds.error:,.0f}")


def _pictures(complete: dict[str, dict[str, list[Run]]]) -> list[Picture]:
    if not complete:
        return []
    return [
        Picture(
            name="gpu_bodies",
            caption="Returns at equal steps on a GPU, ours and Brax's loop on the same engine, by body",
            panels=[
                comparison.by_steps({_WHO[who]: runs for who, runs in of_both.items()}, body)
                for body, of_both in complete.items()
            ],
        )
    ]


def _notes(num_seeds: int) -> list[str]:
    return [
        "Both trainers run the same environment on the same engine, the one `auto` takes, with the body's "
        "tuned settings and its whole budget, to the step, every episode beginning at the environment's own "
        f"first state, as in Brax; {_NUM_EVALS} evaluations of 128 episodes each. Where ours lowers its "
        "learning rate along a line, Brax's stays: it has no such schedule.",
        f"Seeds of each: {num_seeds}, or one where no error is given. {_AT_ONCE} runs shared the card at "
        "any time, so their wall times say nothing; gpu_ant and gpu_humanoid measure wall times, "
        "gpu_engines measures rates.",
    ]
