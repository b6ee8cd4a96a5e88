"""Times the parts of an update on a GPU, and compares its learning with the card's peaks."""

from statistics import median

from bench.measure import requests
from bench.measure.limits import Card, Need, card_of
from bench.measure.report import number
from bench.measure.result import Bars, Figure, Options, Picture, Result, Table
from bench.measure.runs import Run, Runs, Work
from core.environments import catalog

_BODIES = ("ant", "humanoid", "rodent")
_REPEATS = 10
_WARM_UPDATES = 10
_PARTS = ("physics", "rest of the environments", "policy, acting", "learning", "the rest")


def measure(options: Options) -> Result:
    """Measure each body in its own process, under its tuned settings, on the engine that `auto` picks."""
    device = requests.gpu("gpu_profile", options)
    bodies = [body for body in _BODIES if body in catalog.ENVIRONMENTS]
    bodies = ["inverted_pendulum"] if options.quick else bodies
    engines = {
        body: requests.engine(device, body, requests.settings(device, body, options), quick=options.quick)
        for body in bodies
    }
    runs = Runs("gpu_profile", options)
    runs.make(
        Work(
            body,
            "bench.ours.time_pieces",
            {
                **requests.ours(device, body, engines[body], requests.settings(device, body, options)),
                "warm_updates": 2 if options.quick else _WARM_UPDATES,
                "repeats": 2 if options.quick else _REPEATS,
            },
            timeout_s=400,
            about_s=120,
            cache="kernels",
        )
        for body in bodies
    )
    machine = runs.where()
    card = card_of(machine.accelerator)
    parts = {body: split(run) for body, run in runs.done.items()}
    return Result(
        name="gpu_profile",
        title="Where an update's time goes on a GPU",
        command="./run bench gpu_profile",
        quick=options.quick,
        machine=machine,
        figures=[figure for body, run in runs.done.items() for figure in _figures(body, run, card)],
        table=_table(parts) if parts else None,
        rows=[
            {"body": body, "part": part, "repeat": turn, "seconds": seconds}
            for body, run in runs.done.items()
            for part, found in run["seconds"].items()
            for turn, seconds in enumerate(found)
        ],
        notes=[*_notes(engines, card), *runs.notes()],
        pictures=_pictures(parts),
        unfinished=runs.left,
    )


def split(run: Run) -> dict[str, float]:
    """Seconds of an update by its parts, which add up to it; `the rest` holds what timing cannot separate."""
    seconds = {name: median(found) for name, found in run["seconds"].items()}
    learning = seconds["update_twice"] - seconds["update"]
    known = {
        "physics": seconds["engine"],
        "rest of the environments": seconds["stepping"] - seconds["engine"],
        "policy, acting": seconds["acting"] - seconds["stepping"],
        "learning": learning,
    }
    return {**known, "the rest": seconds["epoch"] - sum(known.values())}


def _figures(body: str, run: Run, card: Card | None) -> list[Figure]:
    seconds = {name: median(found) for name, found in run["seconds"].items()}
    learning_s = split(run)["learning"] / run["gradient_steps"]
    need = Need(run["need"]["flops"], run["need"]["bytes"])
    figures = [
        Figure(name=f"{body}: an update", value=1000 * seconds["epoch"], unit="ms"),
        Figure(
            name=f"{body}: physics alone ÷ training", value=seconds["epoch"] / seconds["engine"], unit="×"
        ),
        Figure(name=f"{body}: a gradient step", value=1e6 * learning_s, unit="µs"),
        *_without_kernels(body, run, seconds, learning_s),
        Figure(name=f"{body}: its products, calculated", value=need.flops / 1e9, unit="GFLOP"),
        Figure(name=f"{body}: its bytes, at the least", value=need.bytes / 1e6, unit="MB"),
    ]
    xla = run["xla"]
    if "flops" in xla:
        figures.append(Figure(name=f"{body}: its operations, by XLA", value=xla["flops"] / 1e9, unit="GFLOP"))
    if "bytes" in xla:
        figures.append(Figure(name=f"{body}: its bytes, by XLA", value=xla["bytes"] / 1e6, unit="MB"))
    if card is None:
        return figures
    least_s = need.least_s(card.tf32_flops, card.memory)
    shares = {
        "of the TF32 peak": need.flops / learning_s / card.tf32_flops,
        "of the float32 peak": need.flops / learning_s / card.fp32_flops,
        "of the memory's, the least bytes": need.bytes / learning_s / card.memory,
    }
    if "bytes" in xla:
        shares["of the memory's, XLA's bytes"] = xla["bytes"] / learning_s / card.memory
    return [
        *figures,
        *(Figure(name=f"{body}: {name}", value=100 * share, unit="%") for name, share in shares.items()),
        Figure(
            name=f"{body}: a gradient step ÷ the least it could take", value=learning_s / least_s, unit="×"
        ),
    ]


def _without_kernels(body: str, run: Run, seconds: dict[str, float], learning_s: float) -> list[Figure]:
    """The gain by our kernels, where they take the gradient steps."""
    if "xla_epoch" not in seconds:
        return []
    by_xla = (seconds["xla_update_twice"] - seconds["xla_update"]) / run["gradient_steps"]
    return [
        Figure(name=f"{body}: a gradient step by XLA's operations", value=1e6 * by_xla, unit="µs"),
        Figure(name=f"{body}: that ÷ by our kernels", value=by_xla / learning_s, unit="×"),
        Figure(
            name=f"{body}: an update without our kernels ÷ with them",
            value=seconds["xla_epoch"] / seconds["epoch"],
            unit="×",
        ),
    ]


def _table(parts: dict[str, dict[str, float]]) -> Table:
    rows = [
        [
            body,
            *(
                f"{number(1000 * seconds)} ms, {100 * seconds / sum(of_one.values()):.0f} %"
                for seconds in of_one.values()
            ),
            f"{number(1000 * sum(of_one.values()))} ms",
        ]
        for body, of_one in parts.items()
    ]
    return Table(headings=["Body", *(part.capitalize() for part in _PARTS), "Whole update"], rows=rows)


def _pictures(parts: dict[str, dict[str, float]]) -> list[Picture]:
    if not parts:
        return []
    series: dict[str, list[float | None]] = {
        part: [100 * of_one[part] / sum(of_one.values()) for of_one in parts.values()] for part in _PARTS
    }
    bars = Bars(title="An update's time", unit="%", groups=list(parts), series=series, stacked=True)
    return [
        Picture(name="gpu_profile", caption="Where an update's time goes on a GPU, by body", panels=[bars])
    ]


def _notes(engines: dict[str, str], card: Card | None) -> list[str]:
    on = ", ".join(f"{body} on `{engine}`" for body, engine in engines.items())
    notes = [
        f"Tuned settings for a GPU, {on}, after {_WARM_UPDATES} updates. Every part is a compiled program "
        f"of its own, timed {_REPEATS} times until the device has finished; the medians are shown. Physics: "
        "the engine alone under the update's own actions. The rest of the environments: observation, reward "
        "and new starts. Learning: an update with twice as many passes, less one. The whole is an update "
        "inside the compiled loop, as training runs it; the rest is what the parts leave of it, and may be "
        "negative, because the compiler joins what is timed apart here.",
        "Calculated: the matrix products of both networks forward and backward on every sample, and bytes "
        "with the minibatch read once and parameters and Adam's moments read and written once. XLA counts "
        "operations and bytes of its compiled gradient step, without the products that it hands to cuBLAS, "
        "and with what its kernels hand to each other through the card's caches.",
    ]
    if card is not None:
        notes.append(
            f"Peaks of one {card.name}: {card.tf32_flops / 1e12:.0f} TFLOP/s in TF32, which JAX uses for "
            f"float32 products, {card.fp32_flops / 1e12:.0f} in float32, {card.bf16_flops / 1e12:.0f} in "
            f"BF16; {card.memory / 1e12:.1f} TB/s ({card.source}). The least a gradient step could take is "
            "the longer of its products in TF32 and its least bytes."
        )
    return notes
