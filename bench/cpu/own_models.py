"""Users' own models: physics compiled for each beside C MuJoCo, over bodies that are not in the catalog."""

from importlib.util import find_spec
from pathlib import Path

import mujoco

from bench.measure import comparison
from bench.measure.engine_steps import ENGINES, quotients, steps_table
from bench.measure.result import Figure, Options, Result, at_least
from bench.measure.runs import Run, Runs, Work
from bench.measure.statistics import spread
from core.physics.compiled.coverage import uncovered

_ROBOT = Path(__file__).parents[2] / "examples" / "quadruped.xml"
# The first is the least for which the catalog lets `auto` take `compiled`.
_NUM_ENVS = (64, 16, 256)


def measure(options: Options) -> Result:
    """Each body in its own process, which steps it by both engines in turns."""
    bodies = _bodies(options)
    beyond = {name: why for name, path in bodies.items() if (why := uncovered(_read(path))) is not None}
    runs = Runs("own_models", options)
    runs.make(
        [
            Work(name, "bench.ours.run_steps", _request(path, options), about_s=60)
            for name, path in bodies.items()
            if name not in beyond
        ]
    )
    return Result(
        name="own_models",
        title="Users' own models on the CPU",
        command="./run bench own_models",
        quick=options.quick,
        machine=runs.where(),
        figures=[
            _figure(name, runs.done.get(name), runs.failed.get(name)) for name in bodies if name not in beyond
        ],
        table=steps_table(runs.done, with_start=True),
        rows=comparison.step_rows(runs.done),
        notes=[*_notes(beyond), *runs.notes()],
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


def _num_envs(options: Options) -> list[int]:
    return [4] if options.quick else list(_NUM_ENVS)


def _request(path: Path, options: Options) -> dict[str, object]:
    return {
        "model": str(path),
        "engines": list(ENGINES),
        "num_envs": _num_envs(options),
        "rounds": 2 if options.quick else 5,
        "steps_per_call": 5 if options.quick else 50,
        "own_settings": False,
    }


def _figure(body: str, run: Run | None, why: str | None) -> Figure:
    name = f"{body}: `compiled` ÷ `native`"
    if run is None:
        return Figure(name=name, value=None, unit="×", target=at_least(1), missing=why or "not measured")
    return Figure.of(name, spread(quotients(run, min(run["rates"]["native"], key=_rank))), "×", at_least(1))


def _rank(num_envs: str) -> int:
    """The rule's number of environments comes first."""
    return _NUM_ENVS.index(int(num_envs)) if int(num_envs) in _NUM_ENVS else len(_NUM_ENVS)


def _notes(beyond: dict[str, str]) -> list[str]:
    notes = [
        f"The figures are of {_NUM_ENVS[0]} environments, from which on `auto` takes `compiled`. Each model "
        "is used as one file with default options, without a body's own task. Environments move under random "
        "controls, a second after their start. At least 1 is the target, since `auto` takes it.",
    ]
    if beyond:
        told = "; ".join(f"{name} ({why})" for name, why in beyond.items())
        notes.append(f"`compiled` cannot run the suite's other bodies: {told}.")
    return notes
