"""The programs of an engine: a control step, and the derived fields of a state."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from math import inf, nan

import mujoco

from mujoco_compiled.constraints.contact_room import room_of_lanes, room_of_one
from mujoco_compiled.fields import GEOMETRY, Fields
from mujoco_compiled.lanes.fold import folded
from mujoco_compiled.lanes.lane_constants import NotAlike, alike_inputs, with_lane_constants
from mujoco_compiled.lanes.limbs import Limbs, ways_to_share
from mujoco_compiled.program.arithmetic import Number, Vector, absolute, select
from mujoco_compiled.program.flow import needed
from mujoco_compiled.program.memory import overflow
from mujoco_compiled.program.program import Program, Symbol
from mujoco_compiled.readings.derived import derived
from mujoco_compiled.readings.scene import NO_READINGS, Scene
from mujoco_compiled.smooth.delays import control_places, time_places
from mujoco_compiled.substep import (
    Model,
    Moved,
    SubstepState,
    control_step,
    read_model,
    readings_by_sensor,
    unmoved,
    with_sensors,
)

# In float32 no solver gets below this part of its cost.
_LEAST_TOLERANCE = 1e-6
# The largest float32.
_INFINITE = 3.4028235e38
_LOG = logging.getLogger(__name__)
_OF_FORCES = "qfrc_actuator"
# Where geoms can touch, of a body whose limbs are shared out: there, each is written out.
_MOST_POINTS_IN_LANES = 64


@dataclass(frozen=True)
class Plan:
    """inputs: the sizes of a state's fields and of ctrl, as far as the program reads them, and of the model's
    fields that differ between environments, own. derived: the fields to compute. nconmax: see `put_model`."""

    model: mujoco.MjModel
    inputs: Mapping[str, int]
    own: tuple[str, ...]
    derived: tuple[str, ...]
    nconmax: int | None = None


def control_step_in_lanes(plan: Plan, num_substeps: int) -> Program:
    """For as many lanes as the body has limbs that are alike; for one if it has none. An environment has
    slots for itself."""
    model = read_model(plan.model)
    # More points than these would be too long to write out, and a fold has no tables.
    constraints = model.constraints
    has_tables = constraints.are_of_meshes or constraints.are_of_fields or constraints.are_pulled
    is_short = constraints.num_points <= _MOST_POINTS_IN_LANES and not has_tables
    for limbs in ways_to_share(plan.model) if is_short else ():
        try:
            alike = alike_inputs(model, limbs, plan.own)
            return folded(control_step_program(plan, num_substeps, limbs=limbs), alike, limbs.num_lanes)
        except NotAlike as error:
            _LOG.info("The body is not shared out to %d lanes: %s.", limbs.num_lanes, error)
    return control_step_program(plan, num_substeps, alone=True)


def control_step_program(
    plan: Plan, num_substeps: int, *, alone: bool = False, limbs: Limbs | None = None
) -> Program:
    """From an environment's state and control to its state after it and the derived fields.

    An environment in which a number is past the bound beyond which MuJoCo calls a state unstable, before or
    after, becomes NaN; one that had no room for contacts, infinite. alone: whether an environment has slots
    for itself. limbs: those in whose numbers the program is to be the same.
    """
    program, symbols, model = _begun(plan, alone=alone, limbs=limbs)
    ctrl, state = symbols["ctrl"], _state(plan, symbols)
    moved = control_step(model, num_substeps, state, ctrl, reads_forces=_OF_FORCES in plan.derived)
    after = {"qpos": moved.qpos, "qvel": moved.qvel, "act": moved.act, "qacc_warmstart": moved.qacc}
    after["history"] = _history(plan, symbols["history"], moved, num_substeps * model.timestep)
    time = [one + num_substeps * model.timestep for one in symbols["time"]]
    checked = [*state.qpos, *state.qvel, *state.act, *state.qacc, *state.history, *ctrl]
    is_sound = _is_sound([*checked, *(x for values in after.values() for x in values)])
    lost: Number = nan
    if program.memory.lists:
        has_room = (overflow(program) < 1.0) & (state.qpos[0] < _INFINITE)
        is_sound, lost = is_sound & has_room, select(has_room, nan, inf)
    seen = _derived(plan, symbols, model, moved, time)
    for name, values in (*after.items(), *seen):
        if values:
            program.output(name, [select(is_sound, x, lost) for x in values])
    return needed(program)


def derived_program(plan: Plan, *, alone: bool = False) -> Program:
    """From an environment's state and, where a field depends on forces, its control to the derived fields.
    alone: see `control_step_program`."""
    program, symbols, model = _begun(plan, alone=alone)
    state = _state(plan, symbols)
    standing = Moved(state.qpos, state.qvel, state.act, state.qacc, [], [])
    if _OF_FORCES in plan.derived or model.num_readings:
        standing = unmoved(model, state, symbols["ctrl"])
    for name, values in _derived(plan, symbols, model, standing, symbols["time"]):
        if values:
            program.output(name, values)
    return needed(program)


def _begun(
    plan: Plan, *, alone: bool, limbs: Limbs | None = None
) -> tuple[Program, dict[str, Vector], Model]:
    """A program with its inputs, empty where the plan has none, and the model with the inputs' fields."""
    program = Program(has_team=alone)
    names = ("qpos", "qvel", "act", "qacc_warmstart", "history", "time", "ctrl")
    symbols = {name: list[Symbol]() for name in names}
    symbols |= {name: program.inputs(name, size) for name, size in plan.inputs.items()}
    read = read_model(plan.model, {name: symbols[name] for name in plan.own})
    tolerance = max(_LEAST_TOLERANCE, read.solver.tolerance)
    room = room_of_lanes(plan.nconmax)
    # Boxes that environments have elsewhere are where the model has them in a simulation.
    if alone and (plan.nconmax is not None or not set(GEOMETRY).intersection(plan.own)):
        room = room_of_one(plan.model, read.constraints.contacts, plan.nconmax)
    read = replace(
        read,
        solver=replace(read.solver, tolerance=tolerance),
        constraints=replace(read.constraints, room=room),
    )
    if "sensordata" in plan.derived:
        read = with_sensors(read, plan.model)
    if limbs is None:
        return program, symbols, read
    written_out = replace(read, constraints=replace(read.constraints, are_written_out=True))
    return program, symbols, with_lane_constants(program, written_out, limbs)


def _state(plan: Plan, symbols: Mapping[str, Vector]) -> SubstepState:
    read = symbols["history"]
    history = [read[place] for place in _places(control_places(plan.model))] if read else []
    parts = (symbols[name] for name in ("qpos", "qvel", "act", "qacc_warmstart"))
    return SubstepState(*parts, history=history)


def _history(plan: Plan, before: Vector, moved: Moved, duration: float) -> Vector:
    """MuJoCo's `history` after a step that takes this long, in s."""
    found = list(before)
    for place, control in zip(_places(control_places(plan.model)), moved.history, strict=True):
        found[place] = control
    for place in _places(time_places(plan.model)):
        found[place] = before[place] + duration
    return found


def _places(by_actuator: Mapping[int, Sequence[int]]) -> list[int]:
    return [place for own in by_actuator.values() for place in own]


def _derived(
    plan: Plan, symbols: Mapping[str, Vector], model: Model, moved: Moved, time: Vector
) -> Iterator[tuple[str, Vector]]:
    """One after the other: so each is written out before the next is computed."""
    own = {name: symbols[name] for name in plan.own}
    readings = readings_by_sensor(model, moved) if "sensordata" in plan.derived else NO_READINGS
    scene = Scene(Fields(plan.model, own), moved.qpos, moved.qvel, time[0] if time else 0.0, readings)
    scene.tree = model.tree  # It has the lanes' constants.
    for name in plan.derived:
        yield name, moved.qfrc_actuator if name == _OF_FORCES else derived(scene, (name,))[name]


def _is_sound(values: Sequence[Symbol | float]) -> Symbol:
    bounds = [absolute(x) < mujoco.mjMAXVAL for x in values if isinstance(x, Symbol)]
    return reduce(lambda one, other: one & other, bounds)
