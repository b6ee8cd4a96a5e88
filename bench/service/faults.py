"""The campaign that tries to break the promises of docs/reliability.md, for a number of seeds."""

import os
from collections import Counter
from collections.abc import Sequence

from bench.measure.machine import Machine, this_machine
from bench.measure.result import Figure, Options, Result, below
from bench.measure.statistics import percentile
from tests.faults.campaign.episode import NUM_JOBS
from tests.faults.campaign.runner import Outcome, run_all

_SEEDS = 1000
_SAVE_EVERY = 20


def measure(options: Options) -> Result:
    """Run worlds side by side, one for every two cores; their measurements are saved as they come."""
    machine = this_machine()
    seeds = range(options.first, options.first + (options.seeds or (4 if options.quick else _SEEDS)))
    worlds = options.worlds or max(1, (os.cpu_count() or 2) // 2)
    outcomes: list[tuple[str, Outcome]] = []
    for kinds, outcome in run_all(((kinds, seed) for kinds in options.kinds for seed in seeds), worlds):
        outcomes.append((kinds, outcome))
        print(kinds, outcome.line(), flush=True)
        if len(outcomes) % _SAVE_EVERY == 0:
            _result(outcomes, options, machine, worlds).save(options.out)
    return _result(outcomes, options, machine, worlds)


def _result(
    outcomes: Sequence[tuple[str, Outcome]], options: Options, machine: Machine, worlds: int
) -> Result:
    kinds = Counter(_kind(fault) for _, outcome in outcomes for fault in outcome.faults)
    seconds = [outcome.seconds for _, outcome in outcomes]
    is_default = options.kinds == ("faults",)
    return Result(
        name="faults" if is_default else "_".join(("faults", *options.kinds)),
        title="Faults" if is_default else f"Faults: {', '.join(options.kinds)}",
        command="./run bench faults"
        if is_default
        else f"./run bench faults --kinds {' '.join(options.kinds)}",
        quick=options.quick,
        machine=machine,
        figures=[
            Figure(
                name="episodes with a broken promise",
                value=float(sum(bool(outcome.broken) for _, outcome in outcomes)),
                unit="",
                target=below(1),
            ),
            Figure(name="episodes", value=float(len(outcomes)), unit=""),
            Figure(name="jobs", value=float(NUM_JOBS * len(outcomes)), unit=""),
            Figure(name="faults", value=float(sum(kinds.values())), unit=""),
            Figure(name="an episode, median", value=percentile(seconds, 50), unit="s"),
        ],
        rows=[
            _row(kinds, outcome) for kinds, outcome in sorted(outcomes, key=lambda one: (one[0], one[1].seed))
        ],
        notes=[
            f"Each seed draws {NUM_JOBS} jobs, some of them cancelled, and one to five faults within 3.5 s: "
            + ", ".join(f"{kind} {count}" for kind, count in kinds.most_common())
            + ". Then all is healed, and the checker compares what users were told, and what is stored, with "
            f"an undisturbed run. Worlds side by side: {worlds}."
        ],
    )


def _kind(fault: str) -> str:
    """The kind of fault, without the process it hit and its duration."""
    return " ".join(fault.split()[:2]) if fault.startswith("SIG") else fault.split()[0]


def _row(kinds: str, outcome: Outcome) -> dict[str, str | int | float | bool | None]:
    row: dict[str, str | int | float | bool | None] = {
        "kinds": kinds,
        "seed": outcome.seed,
        "faults": "; ".join(outcome.faults),
        "seconds": outcome.seconds,
    }
    return row | ({"broken": "; ".join(outcome.broken)} if outcome.broken else {})
