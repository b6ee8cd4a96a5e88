"""A user's own model as an environment: the edits of its file, and the checks of its task."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from core.environments.mjcf import edit_check, holding
from core.environments.mjcf.check import problems
from core.environments.mjcf.edit_options import HOME
from core.environments.mjcf.edits import edit
from core.environments.mjcf.info import MjcfOptions
from core.environments.mjcf.model import read
from core.environments.task import TaskEnv, TaskSettings
from core.environments.task_model import compiled, solver_settings, stepped_model
from core.environments.terms.describe import inventory
from core.environments.terms.task import TaskOptions
from core.errors import JobFailed, Problem
from core.physics.engine import EngineBuilder
from core.reasons import Reason

_EDITS = "/environment/options/edits"


def make(
    options: MjcfOptions,
    build_engine: EngineBuilder,
    model: Path | None = None,
    clips: Mapping[str, Path] | None = None,
) -> TaskEnv:
    """The environment under these options. model: the file that holds the model. clips: the files of the
    reference, by id.

    Raises JobFailed("bad_model") if there is none, it does not compile, or the terms do not fit it.
    """
    if model is None:
        raise JobFailed(Reason.BAD_MODEL, f"The file of the model {options.model} is missing.")
    with read(model) as (spec, _):
        _check(edit_check.problems(options.edits, inventory(compiled(spec)), _EDITS))
        edit(spec, options.edits)
        parts = inventory(compiled(spec, options.timestep))
        task = _from_the_pose(options)
        _check(problems(task, parts))
        stepped = stepped_model(spec, task, parts)
        _check(holding.problems(stepped, options.edits, _EDITS))
        settings = TaskSettings(solver_settings(task), clips=clips or {})
        return TaskEnv(task, parts, spec, stepped, build_engine, settings)


def _check(problems: Iterable[Problem]) -> None:
    """Raises JobFailed("bad_model") with all of them."""
    if details := [problem.detail for problem in problems]:
        raise JobFailed(Reason.BAD_MODEL, " ".join(details))


def _from_the_pose(options: MjcfOptions) -> TaskOptions:
    """The task, whose episodes begin in the pose of the edits unless its reset says otherwise."""
    reset = options.reset
    if options.edits.pose is None or reset.keyframe is not None or reset.qpos is not None:
        return options
    return options.model_copy(update={"reset": reset.model_copy(update={"keyframe": HOME})})
