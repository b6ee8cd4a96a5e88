"""Seconds until a body moves as well as Brax's trainer leaves it after its whole budget, on a GPU."""

from bench.cpu.gate import NOTES, works
from bench.measure import requests
from bench.measure.marks import ON_A_GPU
from bench.measure.result import Options, Result
from bench.measure.runs import Runs
from bench.measure.time_to_mark import Gate, figures, picture, rows, table

# A run of Brax's takes minutes: few seeds of it say enough. An evaluation takes it seconds, so it has fewer.
# Where it needs its whole budget, it is cut off at several times what ours needs.
_PEER_STEPS = 3_000_000
_GATES = [
    Gate(
        "ant",
        ON_A_GPU["ant"],
        every_steps=1_000_000,
        most_steps=40_000_000,
        peer_engine="mjx",
        job_steps=10_000_000,
        warm_s=10,
        cold_s=20,
        warm_times=6,
        cold_times=4,
        video_s=20,
        num_peers=2,
        peer_every_steps=_PEER_STEPS,
    ),
    Gate(
        "humanoid",
        ON_A_GPU["humanoid"],
        every_steps=2_000_000,
        most_steps=50_000_000,
        peer_engine="mjx",
        warm_s=20,
        cold_s=35,
        num_peers=1,
        peer_every_steps=_PEER_STEPS,
        peer_most_steps=40_000_000,
    ),
    Gate(
        "half_cheetah",
        ON_A_GPU["half_cheetah"],
        every_steps=2_000_000,
        most_steps=50_000_000,
        peer_engine="mjx",
        warm_times=5,
        num_peers=1,
        peer_every_steps=_PEER_STEPS,
        peer_most_steps=40_000_000,
        peer_most_s=75,
    ),
    Gate(
        "hopper",
        ON_A_GPU["hopper"],
        every_steps=2_000_000,
        most_steps=50_000_000,
        peer_engine="mjx",
        warm_times=5,
        num_peers=1,
        peer_every_steps=_PEER_STEPS,
        peer_most_steps=40_000_000,
        peer_most_s=36,
    ),
    Gate(
        "walker2d",
        ON_A_GPU["walker2d"],
        algorithm="sac",
        every_steps=250_000,
        most_steps=5_000_000,
        peer_engine="mjx",
        warm_times=5,
        num_peers=1,
        peer_every_steps=_PEER_STEPS,
        peer_most_steps=40_000_000,
        peer_most_s=90,
    ),
]


def measure(options: Options) -> Result:
    """Body by body: one cold run of each trainer, then the seeds from a warm cache."""
    device = requests.gpu("gpu_gate", options)
    gates = _GATES[:1] if options.quick else _GATES
    runs = Runs("gpu_gate", options)
    runs.make(work for one in gates for work in works(device, one, options))
    tried = {*runs.done, *runs.failed}
    begun = [one for one in gates if any(name.startswith(f"{one.body}-") for name in tried)]
    pictures = [picture(one, "gpu_gate", runs.done) for one in begun]
    return Result(
        name="gpu_gate",
        title="Seconds to Brax's final return",
        command="./run bench gpu_gate",
        quick=options.quick,
        machine=runs.where(),
        figures=[figure for one in begun for figure in figures(one, runs)],
        table=table(begun, runs.done),
        rows=rows(runs.done),
        notes=[*NOTES, *runs.notes()],
        pictures=[one for one in pictures if one],
        unfinished=runs.left,
    )
