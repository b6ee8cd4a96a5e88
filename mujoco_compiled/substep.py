"""One substep of a model, from its stages.

Source: MuJoCo's documentation, Computation, "Simulation pipeline" and "Numerical integration".
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import islice

import mujoco

from mujoco_compiled.constraints.constraints import (
    Constraints,
    ConstraintState,
    constraint_rows,
    read_constraints,
)
from mujoco_compiled.constraints.rows import ConstraintRows
from mujoco_compiled.constraints.solver import Settings, SolverProblem, acceleration
from mujoco_compiled.fields import NOMINAL, Fields, Own, is_zero
from mujoco_compiled.program.arithmetic import Number, Vector, add, scale
from mujoco_compiled.program.flow import repeat
from mujoco_compiled.program.program import Symbol
from mujoco_compiled.readings.contact_sensors import (
    ContactSensor,
    normal_forces,
    numbers_touching,
    read_contact_sensors,
)
from mujoco_compiled.readings.force_sensors import (
    ForceSensor,
    Instant,
    force_readings,
    read_force_sensors,
)
from mujoco_compiled.smooth.actuation import (
    ActuatorConstants,
    ActuatorState,
    Adhesion,
    Driven,
    actuator_stretch,
    driven,
    read_actuators,
)
from mujoco_compiled.smooth.dynamics import bias_forces, mass_matrix, motion
from mujoco_compiled.smooth.fluid import Fluid, drag_forces, read_fluid
from mujoco_compiled.smooth.forces import passive_forces, weight_held
from mujoco_compiled.smooth.inertia import Inertia, InLoops, WrittenOut, added
from mujoco_compiled.smooth.integration import Implicit, add_slopes, implicit_inertia, integrated
from mujoco_compiled.smooth.kinematics import poses
from mujoco_compiled.smooth.lone_bodies import lone_accelerations, read_lone_bodies
from mujoco_compiled.smooth.paths import Posture
from mujoco_compiled.smooth.tendons import (
    Tendon,
    armature_forces,
    read_tendons,
    tendon_forces,
    tendon_slopes,
    with_armature,
    with_tendons,
)
from mujoco_compiled.smooth.tree import Tree, acts, read_tree
from mujoco_compiled.smooth.tree_loops import TreeLoops


@dataclass(frozen=True)
class Model:
    """timestep: in s. warm_start: whether the solver may begin at the last substep's acceleration.

    touch_sensors, force_sensors: those to read at each substep. contact_sensors: those that count contacts.
    """

    tree: Tree
    tendons: tuple[Tendon, ...]
    actuators: tuple[ActuatorConstants, ...]
    fluid: Fluid
    constraints: Constraints
    timestep: float
    implicit: Implicit
    warm_start: bool
    solver: Settings
    touch_sensors: tuple[ContactSensor, ...] = ()
    force_sensors: tuple[ForceSensor, ...] = ()
    contact_sensors: tuple[ContactSensor, ...] = ()

    @property
    def num_readings(self) -> int:
        return len(self.touch_sensors) + sum(3 if one.frame else 1 for one in self.force_sensors)


@dataclass(frozen=True)
class SubstepState:
    """The state before a substep. qpos: [nq]. qvel: [nv]. act: [na]. qacc: [nv], the last substep's.

    history: of controls, for actuators that act late; see `smooth.delays`.
    """

    qpos: Vector
    qvel: Vector
    act: Vector
    qacc: Vector
    history: Vector = field(default_factory=list[Number], kw_only=True)


@dataclass(frozen=True)
class Moved(SubstepState):
    """qfrc_actuator: [nv], and the readings of touch and force sensors: of the last substep."""

    qfrc_actuator: Vector
    readings: Vector


def read_model(model: mujoco.MjModel, own: Own = NOMINAL) -> Model:
    """The model as the stages read it. own: see `Fields`."""
    fields, bit = Fields(model, own), mujoco.mjtDisableBit
    tree = read_tree(model, own)
    return Model(
        tree=tree,
        tendons=read_tendons(model, own),
        actuators=read_actuators(model, own),
        fluid=read_fluid(model, own),
        constraints=read_constraints(model, own),
        timestep=float(model.opt.timestep),
        implicit=_implicit(fields, tree),
        warm_start=not fields.disables(bit.mjDSBL_WARMSTART),
        solver=Settings(
            iterations=int(model.opt.iterations),
            line_search_iterations=int(model.opt.ls_iterations),
            tolerance=float(model.opt.tolerance),
            line_search_tolerance=float(model.opt.ls_tolerance),
            mean_inertia=float(model.stat.meaninertia),
        ),
    )


def control_step(
    model: Model, num_substeps: int, state: SubstepState, ctrl: Vector, *, reads_forces: bool = False
) -> Moved:
    """The state after some substeps under a control [nu] that stays the same.

    reads_forces: whether `qfrc_actuator` is wanted; it is empty otherwise.
    """
    blank: Vector = [0.0] * len(state.qvel) if reads_forces else []
    sizes = [len(part) for part in (state.history, state.qpos, state.qvel, state.act, state.qacc, blank)]

    def body(carried: list[Number]) -> tuple[list[Number], Number]:
        history, *parts = _parted(carried, sizes)
        moved = substep(model, SubstepState(*parts[:4], history=history), ctrl)
        kept = moved if reads_forces else replace(moved, qfrc_actuator=[])
        return _joined(kept), True

    unread: Vector = [0.0] * model.num_readings
    begun = Moved(state.qpos, state.qvel, state.act, state.qacc, blank, unread, history=state.history)
    history, *ended = _parted(repeat(num_substeps, body, _joined(begun)), sizes)
    return Moved(*ended, history=history)


def substep(model: Model, state: SubstepState, ctrl: Vector) -> Moved:
    """The state one timestep later under a control [nu]."""
    problem, now = _problem(model, state, ctrl)
    found = acceleration(problem, state.qacc if model.warm_start else problem.free, model.solver)
    qvel = add(state.qvel, scale(_integrated(model, problem, found, now), model.timestep))
    qpos = integrated(model.tree, state.qpos, qvel, model.timestep)
    readings, done = _readings(model, problem, now, found), now.done
    return Moved(qpos, qvel, done.act, found, done.on_dofs, readings, history=done.history)


def unmoved(model: Model, state: SubstepState, ctrl: Vector) -> Moved:
    """The state itself, with the forces in it under a control [nu]."""
    problem, now = _problem(model, state, ctrl)
    readings: Vector = []
    if model.num_readings:
        found = acceleration(problem, state.qacc if model.warm_start else problem.free, model.solver)
        readings = _readings(model, problem, now, found)
    return Moved(state.qpos, state.qvel, state.act, state.qacc, now.done.on_dofs, readings)


def readings_by_sensor(model: Model, moved: Moved) -> Mapping[int, Vector]:
    """By number of a sensor: forces and accelerations of the last substep, and how many points touch now."""
    left = iter(moved.readings)
    found = {one.number: [next(left)] for one in model.touch_sensors}
    found |= {one.number: list(islice(left, 3 if one.frame else 1)) for one in model.force_sensors}
    if model.contact_sensors:
        loops = _loops(model, moved)
        now = _posture(model, moved.qpos, moved.qvel, loops)
        state = ConstraintState(moved.qpos, moved.qvel, now.tendons)
        rows = constraint_rows(model.tree, model.constraints, now.at, now.moving, state, loops)
        counted = numbers_touching(model.contact_sensors, model.constraints.contacts, rows)
        pairs = zip(model.contact_sensors, counted, strict=True)
        found |= {one.number: [number] for one, number in pairs}
    return found


def with_sensors(read: Model, model: mujoco.MjModel) -> Model:
    """The model with its sensors of contacts and forces, which `coverage` must have let pass."""
    of_contacts = read_contact_sensors(model, read.constraints.contacts)
    return replace(
        read,
        touch_sensors=tuple(one for one in of_contacts if not one.counts),
        contact_sensors=tuple(one for one in of_contacts if one.counts),
        force_sensors=read_force_sensors(model),
    )


def _problem(model: Model, state: SubstepState, ctrl: Vector) -> tuple[SolverProblem, Instant]:
    """The solver's problem in this state, and the state with the forces of the actuators."""
    tree = model.tree
    loops = _loops(model, state)
    posture = _posture(model, state.qpos, state.qvel, loops)
    at, moving, stretches = posture.at, posture.moving, posture.tendons
    entries = loops.mass_matrix() if loops else mass_matrix(tree, moving)
    mass = with_armature(model.tendons, stretches, entries)
    held = weight_held(tree, at, moving)
    placed = ConstraintState(state.qpos, state.qvel, stretches)

    def constrained() -> ConstraintRows:
        return constraint_rows(tree, model.constraints, at, moving, placed, loops)

    rows = constrained() if model.constraints.are_pulled else None
    done = _driven(model, state, ctrl, posture, held, rows)
    now = Instant(tree, at, moving, state.qvel, stretches, done)
    force = _smooth_forces(model, state, now, held, loops)
    for dof, bias in armature_forces(model.tendons, posture, state.qvel).items():
        force[dof] = force[dof] - bias
    rows = rows or constrained()
    inertia: Inertia = WrittenOut(tree, mass)
    if loops and rows.slots:
        loops.change_mass(entries, mass)
        inertia = InLoops(loops, rows.slots.matrix, mass)
    inertia.begin()
    return SolverProblem(inertia, force, inertia.solve({}, force), rows), now


def _loops(model: Model, state: SubstepState) -> TreeLoops | None:
    """The tree in memory, of a body with contacts in slots, where a program is written."""
    if not model.constraints.are_in_slots or not isinstance(state.qvel[0], Symbol):
        return None
    return TreeLoops(state.qvel[0].program, model.tree)


def _readings(model: Model, problem: SolverProblem, now: Instant, found: Vector) -> Vector:
    """The readings of the touch and force sensors, under the solved acceleration [nv]."""
    felt = list[Vector]()
    if model.touch_sensors:
        felt.append(normal_forces(model.touch_sensors, model.constraints.contacts, problem.rows, found))
    if model.force_sensors:
        felt += force_readings(model.force_sensors, now, found)
    return [number for one in felt for number in one]


def _implicit(fields: Fields, tree: Tree) -> Implicit:
    if fields.model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        return "velocities"
    damped = any(acts(dof.damping) for dof in tree.dofs)
    return "damping" if damped and not fields.disables(mujoco.mjtDisableBit.mjDSBL_EULERDAMP) else "nothing"


def _posture(model: Model, qpos: Vector, qvel: Vector, loops: TreeLoops | None) -> Posture:
    at = poses(model.tree, qpos)
    moving = loops.motion(at, qvel) if loops else motion(model.tree, at, qvel)
    return with_tendons(Posture(model.tree, at, moving, qpos), model.tendons)


def _driven(
    model: Model,
    state: SubstepState,
    ctrl: Vector,
    posture: Posture,
    held: Vector,
    rows: ConstraintRows | None,
) -> Driven:
    """What the actuators do. rows: with the contacts, if actuators pull along them."""

    def pulled(adhesion: Adhesion) -> Vector:
        contacts = model.constraints.contacts
        own = [k for k, one in enumerate(contacts) if {one.one.number, one.other.number} & {*adhesion.geoms}]
        return rows.slots.pulled(own) if rows and rows.slots and own else []

    along = [actuator_stretch(actuator.path, posture, pulled) for actuator in model.actuators]
    own = ActuatorState(along, state.qvel, state.act, ctrl, held, state.history)
    return driven(model.tree, model.actuators, own, model.timestep)


def _smooth_forces(
    model: Model, state: SubstepState, now: Instant, held: Vector, loops: TreeLoops | None
) -> Vector:
    """All forces but the constraints', [nv]. held: see `weight_held`."""
    tree, qvel = model.tree, state.qvel
    passive = add(passive_forces(tree, state.qpos, qvel), tendon_forces(model.tendons, now.tendons, qvel))
    for i, dof in enumerate(tree.dofs):
        if held and not dof.holds_weight:
            passive[i] = passive[i] + held[i]
    dragged = drag_forces(tree, model.fluid, now.at, now.moving)
    bias = loops.bias_forces(qvel, dragged) if loops else bias_forces(tree, now.moving, qvel, dragged)
    return [x + y - z for x, y, z in zip(passive, now.done.on_dofs, bias, strict=True)]


def _integrated(model: Model, problem: SolverProblem, found: Vector, now: Instant) -> Vector:
    """The acceleration by which the velocity changes, [nv].

    All forces, with those of constraints, are M times the acceleration that was found. Computed from the
    constraints instead, they would have the solver's and rounding's errors times the stiffness of contacts.
    """
    if model.implicit == "nothing":
        return found
    tree, inertia = model.tree, problem.inertia
    more = implicit_inertia(tree, now.qvel, model.timestep)
    if model.implicit == "velocities":
        slopes = [*tendon_slopes(model.tendons, now.tendons, now.qvel), *now.done.slopes]
        add_slopes(more, slopes, model.timestep)
    terms = {place: [term] for place, term in more.items() if not is_zero(term)}
    force = inertia.multiply(found)
    inertia.begin()
    changed = inertia.solve(terms, force)
    for lone in read_lone_bodies(tree) if model.implicit == "velocities" else ():
        whole = added(inertia.entries, terms)
        own = lone_accelerations(lone, now.at, now.moving, whole, force, model.timestep)
        changed[lone.dof : lone.dof + 6] = own
    return changed


def _joined(moved: Moved) -> list[Number]:
    state = [*moved.history, *moved.qpos, *moved.qvel, *moved.act, *moved.qacc]
    return [*state, *moved.qfrc_actuator, *moved.readings]


def _parted(values: list[Number], sizes: list[int]) -> list[Vector]:
    """Parts of these sizes, and what is left."""
    parts, place = list[Vector](), 0
    for size in sizes:
        parts.append(values[place : place + size])
        place += size
    return [*parts, values[place:]]
