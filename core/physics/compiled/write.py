"""The programs of an engine: a control step, and the derived fields of a state."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import mujoco

from core.physics.compiled.arithmetic import Vector, absolute, select
from core.physics.compiled.contact_sensors import by_number, read_contact_sensors
from core.physics.compiled.derived import derived
from core.physics.compiled.fields import Fields
from core.physics.compiled.program import Program, Symbol
from core.physics.compiled.scene import Scene
from core.physics.compiled.substep import Model, Moved, State, control_step, read_model, unmoved

# In float32 no solver gets below this part of its cost.
_LEAST_TOLERANCE = 1e-6
_OF_FORCES = "qfrc_actuator"


@dataclass(frozen=True)
class Plan:
    """inputs: the sizes of qpos, qvel, act, qacc_warmstart, time and ctrl, as far as the program reads them,
    and of the model's fields that differ between environments, own. derived: the fields to compute."""

    model: mujoco.MjModel
    inputs: Mapping[str, int]
    own: tuple[str, ...]
    derived: tuple[str, ...]


def control_step_program(plan: Plan, num_substeps: int) -> Program:
    """From an environment's state and control to qpos, qvel, act, qacc_warmstart and the derived fields.

    An environment in which a number is past the bound beyond which MuJoCo calls a state unstable, before or
    after, becomes NaN.
    """
    program, given, model = _begun(plan)
    ctrl, state = given["ctrl"], _state(given)
    moved = control_step(model, num_substeps, state, ctrl, reads_forces=_OF_FORCES in plan.derived)
    after = {"qpos": moved.qpos, "qvel": moved.qvel, "act": moved.act, "qacc_warmstart": moved.qacc}
    time = [one + num_substeps * model.timestep for one in given["time"]]
    seen = _derived(plan, given, model, moved, time)
    checked = [*state.qpos, *state.qvel, *state.act, *state.qacc, *ctrl]
    is_sound = _is_sound([*checked, *(x for values in after.values() for x in values)])
    for name, values in (after | seen).items():
        if values:
            program.output(name, [select(is_sound, x, float("nan")) for x in values])
    return program


def derived_program(plan: Plan) -> Program:
    """From qpos and qvel, without activations and controls, to the derived fields."""
    program, given, model = _begun(plan)
    blank: Vector = [0.0] * plan.model.na
    state = State(given["qpos"], given["qvel"], blank, [0.0] * plan.model.nv)
    standing = Moved(state.qpos, state.qvel, state.act, state.qacc, [], [])
    if _OF_FORCES in plan.derived or model.contact_sensors:
        standing = unmoved(model, state, [0.0] * plan.model.nu)
    for name, values in _derived(plan, given, model, standing, [0.0]).items():
        if values:
            program.output(name, values)
    return program


def _begun(plan: Plan) -> tuple[Program, dict[str, Vector], Model]:
    """A program with its inputs, empty where the plan has none, and the model with the inputs' fields."""
    program = Program()
    given = {name: list[Symbol]() for name in ("qpos", "qvel", "act", "qacc_warmstart", "time", "ctrl")}
    given |= {name: program.inputs(name, size) for name, size in plan.inputs.items()}
    read = read_model(plan.model, {name: given[name] for name in plan.own})
    tolerance = max(_LEAST_TOLERANCE, read.solver.tolerance)
    reads_contacts = "sensordata" in plan.derived
    return (
        program,
        given,
        replace(
            read,
            solver=replace(read.solver, tolerance=tolerance),
            contact_sensors=read_contact_sensors(plan.model, read.constraints.contacts)
            if reads_contacts
            else (),
        ),
    )


def _state(given: Mapping[str, Vector]) -> State:
    return State(given["qpos"], given["qvel"], given["act"], given["qacc_warmstart"])


def _derived(
    plan: Plan, given: Mapping[str, Vector], model: Model, moved: Moved, time: Vector
) -> dict[str, Vector]:
    own = {name: given[name] for name in plan.own}
    readings = by_number(model.contact_sensors, moved.readings)
    scene = Scene(Fields(plan.model, own), moved.qpos, moved.qvel, time[0] if time else 0.0, readings)
    found = derived(scene, tuple(name for name in plan.derived if name != _OF_FORCES))
    return {name: moved.qfrc_actuator if name == _OF_FORCES else found[name] for name in plan.derived}


def _is_sound(values: Sequence[Symbol | float]) -> Symbol:
    bounds = [absolute(x) < mujoco.mjMAXVAL for x in values if isinstance(x, Symbol)]
    return reduce(lambda one, other: one & other, bounds)
