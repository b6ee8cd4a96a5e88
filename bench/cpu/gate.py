"""Seconds until an ant runs, on all cores of this machine."""

from bench.measure import gate
from bench.measure.gate import Gate
from bench.measure.marks import ON_A_CPU
from bench.measure.result import Options, Result
from bench.measure.runs import Runs

# Brax's trainer takes minutes there; a single seed says enough.
_ANT = Gate(
    "ant", ON_A_CPU["ant"], every_steps=100_000, most_steps=3_000_000, peer_engine="native", num_peers=1
)


def measure(options: Options) -> Result:
    """One cold run of each trainer, then the seeds from a warm cache."""
    runs = Runs("gate", options)
    runs.make(gate.works("cpu", _ANT, options))
    picture = gate.picture(_ANT, "gate", runs.done)
    return Result(
        name="gate",
        title="Seconds until an ant runs",
        command="./run bench gate",
        quick=options.quick,
        machine=runs.where(),
        figures=gate.figures(_ANT, runs),
        table=gate.table([_ANT], runs.done),
        rows=gate.rows(runs.done),
        notes=[*gate.NOTES, *runs.notes()],
        pictures=[picture] if picture else [],
        unfinished=runs.left,
    )
