"""The rows of the constraint problem: equalities, friction of joints and tendons, their limits, and contacts.

Every row that the model can ever have is there at all times; where it is not active, its stiffness D is 0.
So the program's shape does not depend on the state. Where many geoms can touch, a program has slots for those
that do (`contact_slots`).
Source: MuJoCo's documentation, Computation, "Constraint model".
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco

from mujoco_compiled.constraints.body_rows import BodyGroup
from mujoco_compiled.constraints.contact_room import Room, room_of_lanes
from mujoco_compiled.constraints.contact_tables import ContactTables
from mujoco_compiled.constraints.contacts import (
    ContactPair,
    contact_rows,
    is_better_by_body,
    read_contacts,
)
from mujoco_compiled.constraints.couplings import Coupling, coupling_row, read_couplings
from mujoco_compiled.constraints.friction_loss import FrictionLoss, friction_row, read_friction_losses
from mujoco_compiled.constraints.laws import RowGroup
from mujoco_compiled.constraints.limits import (
    BallLimit,
    Limit,
    ball_limit_row,
    limit_rows,
    read_ball_limits,
    read_limits,
)
from mujoco_compiled.constraints.rows import ConstraintRows, lower_triangle
from mujoco_compiled.constraints.slot_rows import SlotRows
from mujoco_compiled.constraints.ties import Tie, read_ties, tie_rows
from mujoco_compiled.fields import NOMINAL, Fields, Own
from mujoco_compiled.program.arithmetic import Vector
from mujoco_compiled.smooth.dynamics import Motion
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.matrix_loops import MatrixLoops
from mujoco_compiled.smooth.paths import Path, Stretch, stretch
from mujoco_compiled.smooth.tree import Tree
from mujoco_compiled.smooth.tree_loops import TreeLoops

# With at most this many contacts, each is written out: loops over tables do not pay, nor does skipping those
# that are apart, as some environment of a vector nearly always has one.
FEW_CONTACTS = 8


@dataclass(frozen=True)
class Constraints:
    """All that a model can ever have.

    are_pulled: whether actuators pull along contacts. are_written_out: whether contacts are, however many
    there are. room: in slots.
    """

    ties: tuple[Tie, ...]
    couplings: tuple[Coupling, ...]
    frictions: tuple[FrictionLoss, ...]
    limits: tuple[Limit, ...]
    ball_limits: tuple[BallLimit, ...]
    contacts: tuple[ContactPair, ...]
    are_pulled: bool = False
    are_written_out: bool = False
    room: Room = field(default_factory=room_of_lanes)

    @property
    def are_in_slots(self) -> bool:
        """Whether a program has the contacts in slots."""
        are_needed = self.are_of_fields or (self.are_pulled and bool(self.contacts))
        return (len(self.contacts) > FEW_CONTACTS or are_needed) and not self.are_written_out

    @property
    def are_of_meshes(self) -> bool:
        """Whether some contacts are, whose hulls are tables of the program."""
        return any(geom.hull for contact in self.contacts for geom in (contact.one, contact.other))

    @property
    def are_of_fields(self) -> bool:
        """Whether some contacts are with height fields, which a program has as tables."""
        return any(contact.one.field for contact in self.contacts)

    @property
    def num_points(self) -> int:
        """Where geoms can touch."""
        return sum(contact.num_points for contact in self.contacts)


@dataclass(frozen=True)
class ConstraintState:
    """qpos: [nq]. qvel: [nv]. tendons: the stretches of the model's tendons, as far as they are spatial."""

    qpos: Vector
    qvel: Vector
    tendons: Sequence[Stretch] = ()


def read_constraints(model: mujoco.MjModel, own: Own = NOMINAL) -> Constraints:
    """The model's, without the kinds that it disables. own: see `Fields`."""
    fields, bit = Fields(model, own), mujoco.mjtDisableBit

    def keeps(kind: mujoco.mjtDisableBit) -> bool:
        return not fields.disables(kind, bit.mjDSBL_CONSTRAINT)

    return Constraints(
        ties=read_ties(fields) if keeps(bit.mjDSBL_EQUALITY) else (),
        couplings=read_couplings(fields) if keeps(bit.mjDSBL_EQUALITY) else (),
        frictions=read_friction_losses(fields) if keeps(bit.mjDSBL_FRICTIONLOSS) else (),
        limits=read_limits(fields) if keeps(bit.mjDSBL_LIMIT) else (),
        ball_limits=read_ball_limits(fields) if keeps(bit.mjDSBL_LIMIT) else (),
        contacts=read_contacts(fields) if keeps(bit.mjDSBL_CONTACT) else (),
        are_pulled=bool((model.actuator_trntype == mujoco.mjtTrn.mjTRN_BODY).any()),
    )


def constraint_rows(
    tree: Tree,
    constraints: Constraints,
    at: Poses,
    moving: Motion,
    state: ConstraintState,
    loops: TreeLoops | None = None,
) -> ConstraintRows:
    """All rows in this state, contacts last. loops: of the tree, for contacts in slots."""
    written_out = constraints.contacts if loops is None else ()
    by_body, skips = is_better_by_body(tree, written_out), len(written_out) > FEW_CONTACTS
    touching = [
        point
        for contact in written_out
        for point in contact_rows(tree, contact, at, moving, by_body=by_body, skips=skips)
    ]

    def stretched(path: Path) -> Stretch:
        return stretch(path, state.qpos, state.tendons)

    groups: list[RowGroup | BodyGroup] = [
        *(row for tie in constraints.ties for row in tie_rows(tree, tie, at, moving, state.qvel)),
        *(coupling_row(one, stretched, state.qvel) for one in constraints.couplings),
        *(friction_row(one, stretched(one.path), state.qvel) for one in constraints.frictions),
        *(row for one in constraints.limits for row in limit_rows(one, stretched(one.path), state.qvel)),
        *(ball_limit_row(limit, state.qpos, state.qvel) for limit in constraints.ball_limits),
        *(group for _, group in touching),
    ]
    slots = _slots(loops, constraints, groups, at, moving) if loops else None
    return ConstraintRows(groups, tree, moving.axes, [distance for distance, _ in touching], slots)


def _slots(
    loops: TreeLoops,
    constraints: Constraints,
    groups: Sequence[RowGroup | BodyGroup],
    at: Poses,
    moving: Motion,
) -> SlotRows:
    """The contacts in slots. groups: those that are written out."""
    tables = ContactTables(loops, constraints.contacts, constraints.room)
    tables.fill(at, moving)
    bound = {place for group in groups if isinstance(group, RowGroup) for place in lower_triangle(group)}
    is_dense = any(kind.is_double for kind in tables.kinds) or not bound <= set(loops.tree.entries)
    return SlotRows(loops, MatrixLoops(loops, is_dense=is_dense), tables)
