"""Examines a model: compiles it, lets it fall, and loads it into each engine."""

import json
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, get_args

import mujoco
import numpy as np

from core.environments.mjcf.edit_options import ModelEdits
from core.environments.mjcf.edits import edit, edits_for_compiled, without_drawings
from core.environments.mjcf.model import SLEEP_IS_OFF, is_to_sleep, read
from core.environments.mjcf.recipe import NoRecipe, Recipe, recipe
from core.environments.task_model import compiled
from core.environments.terms.describe import can_go_forward, inventory, root_of
from core.environments.terms.inventory import Inventory
from core.environments.terms.task import LONGEST_STEP_S, SHORTEST_STEP_S
from core.errors import BadModel, JobFailed
from core.physics.availability import EngineName
from core.physics.coverage import check_runs, unread_by_engine
from core.user_models.record import Description
from mujoco_compiled import left_out
from worker.validation.letting_go import let_go, notes
from worker.validation.trials import tried, what_keeps, with_choices

_DRIVEN = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_NO_ACTUATORS = "It has no actuators: jobs give it servos (`edits.servos`)."
_MUST_BE_FINITE = (
    *("actuator_gainprm", "actuator_gear", "body_inertia", "body_mass", "body_pos", "body_quat"),
    *("dof_armature", "dof_damping", "geom_pos", "geom_size", "jnt_range", "jnt_stiffness", "qpos0"),
)


def findings(file: Path) -> Iterator[Description]:
    """The description, and again with the result of each engine; the last one is complete.

    Raises BadModel or JobFailed if no job could use the model.
    """
    with read(file) as (spec, main):
        sleeps = is_to_sleep(spec)
        model = compiled(spec)
        _check(model)
        walking = _walking(spec)
        edited = _judged_with_edits(walking.options, spec, model)
        engines = _judged_by_reading(model)
        if (why := engines["compiled"]) is not None:
            engines["compiled"] = _with_a_remedy(why, spec, model)
        found = _with_unread_sensors(inventory(model), model)
        readable = [sensor.name for sensor in found.sensors if sensor.name and not sensor.beyond]
        stepped = compiled(spec, sensors=readable)
    fall = let_go(model)
    description = Description(
        inventory=found,
        main=main,
        engines=engines,
        physics_steps_per_second=fall.steps_per_second,
        settled_height=float(fall.ended[2]),
        notes=[
            *([SLEEP_IS_OFF] if sleeps else []),
            *notes(model, found, fall),
            *_of_the_default_reward(model),
            *([] if model.nu else [_NO_ACTUATORS]),
            *(f"On the engine `compiled`, {one}." for one in left_out(model) if engines["compiled"] is None),
        ],
        recipe=walking.options or None,
        recipe_notes=list(walking.notes),
        recipe_engines=edited,
    )
    description = with_choices(description)
    yield description
    yield from map(with_choices, tried(description, stepped, model))


def _with_unread_sensors(found: Inventory, model: mujoco.MjModel) -> Inventory:
    beyond = unread_by_engine(model)
    sensors = [
        sensor.model_copy(update={"beyond": dict(beyond.get(number, {}))})
        for number, sensor in enumerate(found.sensors)
    ]
    return found.model_copy(update={"sensors": sensors})


def _of_the_default_reward(model: mujoco.MjModel) -> Iterator[str]:
    root = root_of(model)
    if not can_go_forward(model, root):
        yield (
            f"The root, {model.body(root).name!r}, cannot move along x, so the default reward changes with "
            "the size of the actions alone: give `reward` terms, or name another body as `root`."
        )


def _judged_by_reading(model: mujoco.MjModel) -> dict[EngineName, str | None]:
    """The findings of reading the model, without loading an engine: what `native` and `compiled` do, and what
    the others would leave out in silence."""
    engines: dict[EngineName, str | None] = {
        "native": what_keeps(partial(check_runs, "native"), model),
        "compiled": what_keeps(partial(check_runs, "compiled"), model),
    }
    for name in get_args(EngineName):
        if name not in engines and (why := what_keeps(partial(check_runs, name), model)):
            engines[name] = why
    return engines


def _walking(spec: mujoco.MjSpec) -> Recipe:
    try:
        return recipe(spec)
    except (NoRecipe, JobFailed) as error:
        return Recipe({}, [f"There is no recipe for it: {error}."])
    except Exception as error:  # A model that it cannot be tried on may be a good one.
        return Recipe({}, [f"There is no recipe for it: {' '.join(str(error).split())[:300]}"])


def _judged_with_edits(
    options: Mapping[str, Any], spec: mujoco.MjSpec, model: mujoco.MjModel
) -> dict[EngineName, str | None]:
    """The same findings of the model as the recipe's job has it; none without a recipe."""
    if not options:
        return {}
    try:
        edit(changed := without_drawings(spec, model), ModelEdits.model_validate(options["edits"]))
        return _judged_by_reading(compiled(changed, options.get("timestep"), sensors=[]))
    except (JobFailed, ValueError):  # Its job says why.
        return {}


def _with_a_remedy(why: str, spec: mujoco.MjSpec, model: mujoco.MjModel) -> str:
    """The refusal of `compiled`, with the edits under which it does not refuse."""
    try:
        edits = edits_for_compiled(without_drawings(spec, model))
    except (JobFailed, ValueError):
        return why
    if edits is None:
        return why
    changes = edits.model_dump(include={"floor", "collide"})
    return f"{why} Or let less of it collide: `edits` {json.dumps(changes)}."


def _check(model: mujoco.MjModel) -> None:
    if model.nu == 0 and not np.isin(model.jnt_type, _DRIVEN).any():
        raise BadModel("The model has no actuators, and no hinge or slide that a servo could move.")
    if model.nv == 0:
        raise BadModel("The model has no joints, so nothing in it can move.")
    if not SHORTEST_STEP_S <= model.opt.timestep <= LONGEST_STEP_S:
        raise BadModel(
            f"The model's timestep is {model.opt.timestep:g} s, and may be {SHORTEST_STEP_S:g} s to "
            f"{LONGEST_STEP_S:g} s."
        )
    for name in _MUST_BE_FINITE:
        if not np.isfinite(getattr(model, name)).all():
            raise BadModel(f"The model's {name} has a value that is not a finite number.")
    if not model.body_mass.sum() > 0:
        raise BadModel("The model has no mass.")
