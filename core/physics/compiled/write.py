"""The programs of an engine: a control step, and the fields of a state."""

from collections.abc import Mapping, Sequence
from functools import reduce

import mujoco

from core.physics.compiled.arithmetic import Vector, absolute, select
from core.physics.compiled.program import Program, Symbol
from core.physics.compiled.substep import Model, control_step


def control_step_program(model: Model, num_substeps: int, inputs: Mapping[str, int]) -> Program:
    """From qpos, qvel, qacc_warmstart and ctrl to the first three after some substeps.

    An environment in which a number is past the bound beyond which MuJoCo calls a state unstable, before or
    after, becomes NaN.
    """
    program = Program()
    given: dict[str, Vector] = {name: list(program.inputs(name, size)) for name, size in inputs.items()}
    moved = control_step(
        model, num_substeps, given["qpos"], given["qvel"], given["qacc_warmstart"], given.get("ctrl", [])
    )
    after = {"qpos": moved.qpos, "qvel": moved.qvel, "qacc_warmstart": moved.qacc}
    is_sound = _is_sound([x for values in (*given.values(), *after.values()) for x in values])
    for name, values in after.items():
        program.output(name, [select(is_sound, x, float("nan")) for x in values])
    return program


def _is_sound(values: Sequence[Symbol | float]) -> Symbol:
    bounds = [absolute(x) < mujoco.mjMAXVAL for x in values if isinstance(x, Symbol)]
    return reduce(lambda one, other: one & other, bounds)
