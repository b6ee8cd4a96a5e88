"""Users' own models: physics compiled for each beside another engine, over bodies not in the catalog."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import mujoco

from bench.measure import comparison
from bench.measure.engine_steps import ENGINES, ON_A_GPU, quotients, steps_table
from bench.measure.result import Figure, Options, Result, at_least
from bench.measure.runs import Run, Runs, Work
from bench.measure.statistics import spread
from core.environments.info import Device
from core.environments.mjcf.describe import inventory
from core.environments.mjcf.info import INFO as MJCF
from core.physics.availability import choose
from core.physics.compiled.coverage import uncovered

_ROBOT = Path(__file__).parents[2] / "examples" / "quadruped.xml"


@dataclass(frozen=True)
class _Case:
    """engines: `compiled` and its peer. num_envs: numbers of environments; the figures are of the first."""

    engines: Sequence[str]
    num_envs: Sequence[int]
    steps_per_call: int


_CASES: dict[Device, _Case] = {
    # The first is the least for which the catalog lets `auto` take `compiled`.
    "cpu": _Case(ENGINES, (64, 16, 256), 50),
    # The first is the number that the tuned settings take.
    "gpu": _Case(ON_A_GPU, (2048, 512, 8192), 100),
}


def measure(options: Options) -> Result:
    """On the CPU; see `measured`."""
    return measured(options, "own_models", "cpu")


def measured(options: Options, name: str, device: Device) -> Result:
    """Each body in its own process, which steps it by both engines in turns."""
    case = _CASES[device]
    bodies = _bodies(options)
    beyond = {name: why for name, path in bodies.items() if (why := uncovered(_read(path))) is not None}
    runs = Runs(name, options)
    runs.make(
        [
            Work(body, "bench.ours.run_steps", _request(path, device, case, options), about_s=60)
            for body, path in bodies.items()
            if body not in beyond
        ]
    )
    return Result(
        name=name,
        title=f"Users' own models on a {device.upper()}",
        command=f"./run bench {name}",
        quick=options.quick,
        machine=runs.where(),
        figures=[
            _figure(body, _is_taken(path, device, case), case, runs.done.get(body), runs.failed.get(body))
            for body, path in bodies.items()
            if body not in beyond
        ],
        table=steps_table(runs.done, with_start=True),
        rows=comparison.step_rows(runs.done),
        notes=[*_notes(case, beyond), *runs.notes()],
        unfinished=runs.left,
    )


def _bodies(options: Options) -> dict[str, Path]:
    """The robot of the tutorial, and dm_control's suite."""
    found = {"the tutorial's quadruped": _ROBOT}
    spec = find_spec("dm_control.suite")
    if spec is None or spec.origin is None or options.quick:
        return found
    files = sorted(Path(spec.origin).parent.glob("*.xml"))
    # One has nothing that moves: the suite's code puts its bodies in.
    return {**found, **{path.stem: path for path in files if _read(path).nv}}


def _read(path: Path) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(path))


def _request(path: Path, device: Device, case: _Case, options: Options) -> dict[str, object]:
    return {
        "model": str(path),
        "device": device,
        "engines": list(case.engines),
        "num_envs": [4] if options.quick else list(case.num_envs),
        "rounds": 2 if options.quick else 5,
        "steps_per_call": 5 if options.quick else case.steps_per_call,
        "own_settings": False,
    }


def _is_taken(path: Path, device: Device, case: _Case) -> bool:
    """Whether `auto` takes `compiled` for the model as a user's own."""
    rules, body = MJCF.rules_on(device), inventory(_read(path)).body_size
    return choose("auto", device, case.num_envs[0], rules, body=body).name == "compiled"


def _figure(body: str, is_taken: bool, case: _Case, run: Run | None, why: str | None) -> Figure:
    name, target = f"{body}: `compiled` ÷ `{case.engines[1]}`", at_least(1) if is_taken else None
    if run is None:
        return Figure(name=name, value=None, unit="×", target=target, missing=why or "not measured")
    first, *_ = run["rates"]["compiled"]
    return Figure.of(name, spread(quotients(run, first)), "×", target)


def _notes(case: _Case, beyond: dict[str, str]) -> list[str]:
    notes = [
        f"The figures are of {case.num_envs[0]:,} environments. Each model is used as one file with default "
        "options, without a body's own task. Environments move under random controls, a second after their "
        "start. At least 1 is the target where `auto` takes `compiled`.",
    ]
    if beyond:
        told = "; ".join(f"{name} ({why})" for name, why in beyond.items())
        notes.append(f"`compiled` cannot run the suite's other bodies: {told}.")
    return notes
