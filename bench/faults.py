"""The campaign that tries to break the promises of docs/reliability.md, as many seeds as asked for."""

from collections import Counter

from bench.machine import this_machine
from bench.result import Figure, Options, Result, below
from bench.statistics import percentile
from tests.faults.campaign.episode import NUM_JOBS, Outcome, run
from tests.faults.campaign.world import World

_SEEDS = 1000


def measure(options: Options) -> Result:
    """One world for every fifty episodes, so that none runs on what hundreds before it have left."""
    machine = this_machine()
    seeds = range(options.seeds or (5 if options.quick else _SEEDS))
    outcomes: list[Outcome] = []
    for first in range(0, len(seeds), 50):
        with World() as world:
            for seed in seeds[first : first + 50]:
                outcomes.append(outcome := run(world, seed))
                print(f"seed {seed}: {', '.join(outcome.broken) or 'kept'} ({'; '.join(outcome.faults)})")
    kinds = Counter(fault.split()[0] for outcome in outcomes for fault in outcome.faults)
    seconds = [outcome.seconds for outcome in outcomes]
    return Result(
        name="faults",
        title="Faults",
        command="./run bench faults",
        quick=options.quick,
        machine=machine,
        figures=[
            Figure(
                name="episodes with a broken promise",
                value=float(sum(bool(outcome.broken) for outcome in outcomes)),
                unit="",
                target=below(1),
            ),
            Figure(name="episodes", value=float(len(outcomes)), unit=""),
            Figure(name="jobs", value=float(NUM_JOBS * len(outcomes)), unit=""),
            Figure(name="faults", value=float(sum(kinds.values())), unit=""),
            Figure(name="an episode, median", value=percentile(seconds, 50), unit="s"),
        ],
        rows=[outcome.__dict__ for outcome in outcomes],
        notes=[
            f"Each seed draws {NUM_JOBS} jobs, some of them cancelled, and one to five faults within 3.5 s: "
            + ", ".join(f"{kind} {count}" for kind, count in kinds.most_common())
            + ". Then all is healed, and the checker compares what users were told, and what is stored, with "
            "an undisturbed run."
        ],
    )
