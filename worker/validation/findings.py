"""Examines a model: compiles it, lets it fall, and loads it into each engine."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from core.environments.mjcf.describe import height_of, inventory, root_of
from core.environments.mjcf.info import LONGEST_STEP_S, SHORTEST_STEP_S
from core.environments.mjcf.inventory import Inventory
from core.environments.mjcf.model import compiled, read
from core.errors import BadModel
from core.physics.availability import EngineName, is_installed
from core.physics.compiled.refusal import check_covered
from core.physics.model import initial_qpos
from core.user_models.record import Description

_TRIAL_S, _TRIAL_WALL_S, _STEPS_AT_ONCE = 2.0, 0.5, 20
_LONGEST_REASON = 300
_FELL_M = 5.0
_UNSTABLE = ("mjWARN_BADQPOS", "mjWARN_BADQVEL", "mjWARN_BADQACC")
_MUST_BE_FINITE = (
    *("actuator_gainprm", "actuator_gear", "body_inertia", "body_mass", "body_pos", "body_quat"),
    *("dof_armature", "dof_damping", "geom_pos", "geom_size", "jnt_range", "jnt_stiffness", "qpos0"),
)


def findings(file: Path) -> Iterator[Description]:
    """The description, and again with the result of each engine.

    Raises BadModel or JobFailed if no job could use the model.
    """
    with read(file) as (spec, main):
        model = compiled(spec)
    _check(model)
    trial = _let_go(model)
    found = inventory(model)
    description = Description(
        inventory=found,
        main=main,
        # Reading the model shows whether `compiled` can run it: that needs no compiler.
        engines={"native": None, "compiled": _what_keeps(check_covered, model)},
        physics_steps_per_second=trial.steps_per_second,
        settled_height=trial.height,
        notes=list(_notes(found, trial)),
    )
    yield description
    turns: list[tuple[EngineName, Callable[[mujoco.MjModel], None]]] = [("mjx", _try_mjx)]
    if is_installed("warp"):
        turns.append(("warp", _try_warp))
    for name, attempt in turns:
        engines = {**description.engines, name: _what_keeps(attempt, model)}
        description = description.model_copy(update={"engines": engines})
        yield description
    yield description.model_copy(update={"complete": True})


@dataclass(frozen=True)
class _Trial:
    steps_per_second: float
    height: float
    stable: bool


def _check(model: mujoco.MjModel) -> None:
    if model.nu == 0:
        raise BadModel("The model has no actuators, so no policy could move it.")
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


def _notes(found: Inventory, trial: _Trial) -> Iterator[str]:
    if not trial.stable:
        yield "It becomes unstable within 2 s, without any action: try a smaller `timestep`."
    elif found.travels and (fell := found.initial_height - trial.height) > _FELL_M:
        yield f"It fell {fell:.0f} m within 2 s: there is no floor that it touches."


def _let_go(model: mujoco.MjModel) -> _Trial:
    """Steps it without actions: how fast that is, and where its root ends."""
    data = mujoco.MjData(model)
    data.qpos[:] = initial_qpos(model)
    steps, began = 0, time.perf_counter()
    while data.time < _TRIAL_S and time.perf_counter() - began < _TRIAL_WALL_S:
        mujoco.mj_step(model, data, _STEPS_AT_ONCE)
        steps += _STEPS_AT_ONCE
    rate = steps / (time.perf_counter() - began)
    stable = not any(data.warning[getattr(mujoco.mjtWarning, kind)].number for kind in _UNSTABLE)
    height = height_of(model, data.qpos, root_of(model))
    return _Trial(rate, height if np.isfinite(height) else 0.0, stable)


def _what_keeps(attempt: Callable[[mujoco.MjModel], None], model: mujoco.MjModel) -> str | None:
    try:
        attempt(model)
    except Exception as error:  # Whatever it is, it is the answer.
        words = " ".join(str(error).split()) or type(error).__name__
        return f"{words[:_LONGEST_REASON].removesuffix('.')}."
    return None


def _try_mjx(model: mujoco.MjModel) -> None:
    """Load it and trace a step, which alone shows some of what MJX lacks. Nothing is compiled."""
    import jax
    from mujoco import mjx

    on_device = mjx.put_model(model)
    jax.eval_shape(lambda: mjx.step(on_device, mjx.make_data(model)))


def _try_warp(model: mujoco.MjModel) -> None:
    import warp
    from mujoco.mjx.third_party import mujoco_warp

    warp.config.log_level = warp.LOG_ERROR
    with warp.ScopedDevice("cpu"):
        put: Any = mujoco_warp.put_model
        put(model)
