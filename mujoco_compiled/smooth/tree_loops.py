"""A tree's dynamics in memory, and for large trees in loops: `dynamics` for bodies with contacts in slots.

Motions are carried from the root to the leaves and forces from the leaves to the root in rows of arrays: row
0 stands still, row i + 1 is degree of freedom i, and a body is where the last degree of freedom that moves it
is.

Code that is written out grows with the tree, and must be fetched: on an H200 an instruction took 25 cycles
where the code did not fit the cache, and 4 to 6 in a loop. A loop takes several times as many instructions,
for places and memory.
"""

from collections.abc import Callable, Sequence
from functools import partial

from mujoco_compiled.program.arithmetic import Vector, add, dot, scale, subtract
from mujoco_compiled.program.memory import (
    Array,
    Integers,
    Table,
    array,
    column,
    for_each,
    integers,
)
from mujoco_compiled.program.program import Place, Program
from mujoco_compiled.smooth.dynamics import (
    Entries,
    Motion,
    Wrenches,
    axes_of,
    bias_forces,
    centre_of,
    mass_matrix,
    motion,
)
from mujoco_compiled.smooth.factor import multiply
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.spatial import about_centre, cross_force, cross_motion, momentum
from mujoco_compiled.smooth.tree import Tree

_STILL = [0.0] * 6
# Measured on an H200: up to the first, all is faster written out; up to the second, products are, which have
# few operations.
FEW_DOFS, _MANY_DOFS = 20, 40


class TreeLoops:
    """rows: by body, its row. By row: axes and velocities of the last `motion`, motions of the last `move`.
    mass: the entries of the last `mass_matrix`. bends: room for bodies' curvatures."""

    def __init__(self, program: Program, tree: Tree) -> None:
        self.program, self.tree = program, tree
        size = len(tree.dofs)
        self.rows = rows_of(tree)
        self._is_tiny, self._is_small = size <= FEW_DOFS, size <= _MANY_DOFS
        self._has_team = program.has_team and not self._is_tiny
        # What routines work on, if there are any.
        self.room = partial(array, program, space="common" if self._has_team else "numbers")
        self._above = integers(program, "rows above", [_above(tree, i) for i in range(size)])
        self._before_joint = integers(program, "rows before joints", _before_joints(tree))
        self._body_rows = integers(program, "rows of bodies", self.rows)
        # The lower triangle's entries, row by row: each degree of freedom's ancestors, and itself.
        chains = [(*dof.ancestors, i) for i, dof in enumerate(tree.dofs)]
        begins = [sum(map(len, chains[:i])) for i in range(size)]
        self._begins = integers(program, "chains' begins", begins)
        self._lengths = integers(program, "chains' lengths", [len(chain) for chain in chains])
        self._links = integers(program, "chains", [j for chain in chains for j in chain])
        ends = [begin + len(chain) - 1 for begin, chain in zip(begins, chains, strict=True)]
        self._diagonal = integers(program, "chains' ends", ends)
        self._armatures = column(program, "armatures", [dof.armature for dof in tree.dofs])
        bodies = tree.bodies
        self._masses = column(program, "masses", [body.mass for body in bodies])
        self._own_inertias = [
            column(program, f"inertias {k}", own)
            for k, own in enumerate(zip(*(body.inertia for body in bodies), strict=True))
        ]
        # A card has the first of them nearest.
        self.mass = self.room("mass", len(tree.entries))
        self.axes = self.room("axes", size + 1, 6)
        self._vector = self.room("a vector", size)
        self._product = self.room("a product", size)
        self.bends = self.room("bends", size + 1, 21)
        self._rates = array(program, "axis rates", size + 1, 6)
        self.velocities = array(program, "rows' velocities", size + 1, 6)
        self._placed = array(program, "rotations and offsets", len(bodies), 12)
        self._inertias = self.room("bodies' inertias", len(bodies), 10)
        self._composites = self.room("composites", size + 1, 10)
        self.motions = self.room("rows' motions", size + 1, 6)
        self._carried = self.room("carried", size + 1, 6)

    def motion(self, at: Poses, qvel: Vector) -> Motion:
        """As `dynamics.motion`."""
        if self._is_tiny:
            self._motion = found = motion(self.tree, at, qvel)
            for i, axis in enumerate(found.axes):
                self.axes.store(i + 1, axis)
            self.velocities.store(0, _STILL)
            for body, row in enumerate(self.rows):
                if row:
                    self.velocities.store(row, found.velocities[body])
            return found
        tree = self.tree
        centres = {root: centre_of(tree, at, root) for root in {body.root for body in tree.bodies[1:]}}
        for body in range(1, len(tree.bodies)):
            for joint in tree.bodies[body].joints:
                axes = axes_of(joint, at, body, centres[tree.bodies[body].root])
                for dof, axis in enumerate((axis for group in axes for axis in group), joint.dof):
                    self.axes.store(dof + 1, axis)
        for body in range(1, len(tree.bodies)):
            offset = subtract(at.centres[body], centres[tree.bodies[body].root])
            self._placed.store(body, [*(x for line in at.rotations[body] for x in line), *offset])
        self._inertias.store(0, [0.0] * 10)
        for_each(self.program, len(tree.bodies) - 1, self._note_inertia)
        self._note(qvel)
        self.velocities.store(0, _STILL)
        for_each(self.program, len(tree.dofs), self._note_velocity)
        return Motion(
            axes=[self.axes.row(i + 1) for i in range(len(tree.dofs))],
            axis_rates=[self._rates.row(i + 1) for i in range(len(tree.dofs))],
            inertias=[self._inertias.row(body) for body in range(len(tree.bodies))],
            velocities=[self.velocities.row(row) for row in self.rows],
            centres=centres,
        )

    def mass_matrix(self) -> Entries:
        """As `dynamics.mass_matrix`, of the last `motion`."""
        if self._is_tiny:
            entries = mass_matrix(self.tree, self._motion)
            for number, place in enumerate(self.tree.entries):
                self.mass.store(number, [entries[place]])
            return entries
        self.share("mass matrix", self._fill_mass)

        def add_armature(dof: Place, _: Vector) -> Vector:
            self.mass.add(self._diagonal.at(dof), [self._armatures.at(dof)])
            return []

        for_each(self.program, len(self.tree.dofs), add_armature)
        return {place: self.mass.row(number)[0] for number, place in enumerate(self.tree.entries)}

    def _fill_mass(self) -> None:
        def collect(composites: Array, inertias: Array) -> None:
            def add_body(body: Place, _: Vector) -> Vector:
                composites.add(self._body_rows.at(body), inertias.row(body))
                return []

            self.clear(composites)
            for_each(self.program, len(self.tree.bodies), add_body)
            self._carry(composites)

        def fill(dof: Place, _: Vector) -> Vector:
            force = momentum(self._composites.row(dof + 1), self.axes.row(dof + 1))
            begin = self._begins.at(dof)

            def entry(link: Place, _: Vector) -> Vector:
                place = begin + link
                self.mass.store(place, [dot(self.axes.row(self._links.at(place) + 1), force)])
                return []

            return for_each(self.program, self._lengths.at(dof), entry)

        self._by_parts(2, [self._composites, self._inertias], collect)
        for_each(self.program, len(self.tree.dofs), fill, is_parted=True)

    def change_mass(self, before: Entries, after: Entries) -> None:
        """Puts the entries that are others now."""
        for number, place in enumerate(self.tree.entries):
            if after[place] != before[place]:
                self.mass.store(number, [after[place]])

    def bias_forces(self, qvel: Vector, pushed: Wrenches) -> Vector:
        """As `dynamics.bias_forces`, of the last `motion`."""
        if self._is_tiny:
            return bias_forces(self.tree, self._motion, qvel, pushed)
        self._note(qvel)
        self.motions.store(0, [0.0, 0.0, 0.0, *scale(self.tree.gravity, -1.0)])

        def accelerate(dof: Place, _: Vector) -> Vector:
            change = scale(self._rates.row(dof + 1), self._vector.row(dof)[0])
            self.motions.store(dof + 1, add(self.motions.row(self._above.at(dof)), change))
            return []

        def collect(body: Place, _: Vector) -> Vector:
            row, inertia = self._body_rows.at(body), self._inertias.row(body)
            velocity = self.velocities.row(row)
            turning = cross_force(velocity, momentum(inertia, velocity))
            self._carried.add(row, add(momentum(inertia, self.motions.row(row)), turning))
            return []

        for_each(self.program, len(self.tree.dofs), accelerate)
        self.clear(self._carried)
        for_each(self.program, len(self.tree.bodies), collect)
        for body, force in pushed.items():
            self._carried.add(self.rows[body], scale(force, -1.0))
        return self.on_dofs(self._carried)

    def move(self, vector: Vector) -> None:
        """Sets `motions` to those that a vector [nv] gives."""
        if self._is_small:
            self._move_written_out(vector)
            return
        self._note(vector)
        self.share("move", self._move)

    def _move(self) -> None:
        def move_parts(motions: Array, axes: Array) -> None:
            def move(dof: Place, _: Vector) -> Vector:
                change = scale(axes.row(dof + 1), self._vector.row(dof)[0])
                motions.store(dof + 1, add(motions.row(self._above.at(dof)), change))
                return []

            motions.store(0, [0.0] * len(motions))
            for_each(self.program, len(self.tree.dofs), move)

        self._by_parts(2, [self.motions, self.axes], move_parts)

    def on_dofs(self, wrenches: Array) -> Vector:
        """The forces [nv] of spatial forces [6] by row, which are carried to the root."""
        if self._is_small:
            return self._on_dofs_written_out(wrenches)

        self.share(f"forces of {wrenches.first}", lambda: self._push(wrenches))
        return [self._vector.row(i)[0] for i in range(len(self.tree.dofs))]

    def _push(self, wrenches: Array) -> None:
        def push(dof: Place, _: Vector) -> Vector:
            self._vector.store(dof, [dot(self.axes.row(dof + 1), wrenches.row(dof + 1))])
            return []

        self._by_parts(2, [wrenches], self._carry)
        for_each(self.program, len(self.tree.dofs), push, is_parted=True)

    def multiply(self, vector: Vector) -> Vector:
        """M x [nv]."""
        if self._is_small:
            entries = {place: self.mass.row(number)[0] for number, place in enumerate(self.tree.entries)}
            return multiply(self.tree, entries, vector)
        self._note(vector)
        self.share("multiply", self._multiply)
        return [self._product.row(i)[0] for i in range(len(self.tree.dofs))]

    def _multiply(self) -> None:
        entries = {place: number for number, place in enumerate(self.tree.entries)}
        size = range(len(self.tree.dofs))
        terms = Table(
            self.program,
            "products",
            [
                [(entries[max(i, j), min(i, j)], j) for j in size if (max(i, j), min(i, j)) in entries]
                for i in size
            ],
        )

        def along(dof: Place, _: Vector) -> Vector:
            def term(row: Place, now: Vector) -> Vector:
                entry, other = terms.at(row)
                return [now[0] + self.mass.row(entry)[0] * self._vector.row(other)[0]]

            self._product.store(dof, terms.for_each(dof, term, [0.0]))
            return []

        for_each(self.program, len(self.tree.dofs), along, is_parted=True)

    def add_projected(self, bends: Array, places: Integers, entries: Array) -> None:
        """Adds Aᵀ K A to the tree's entries. bends: by row, the lower triangle of a body's K [21], which are
        carried to the root. places: of the tree's entries."""

        self.share("projected", lambda: self._add_projected(bends, places, entries))

    def _add_projected(self, bends: Array, places: Integers, entries: Array) -> None:
        def fill(dof: Place, _: Vector) -> Vector:
            bend, axis = bends.row(dof + 1), self.axes.row(dof + 1)
            force = [dot([bend[lower(k, m)] for m in range(6)], axis) for k in range(6)]
            begin = self._begins.at(dof)

            def entry(link: Place, _: Vector) -> Vector:
                place = begin + link
                entries.add(places.at(place), [dot(self.axes.row(self._links.at(place) + 1), force)])
                return []

            return for_each(self.program, self._lengths.at(dof), entry)

        self._by_parts(3, [bends], self._carry)
        for_each(self.program, len(self.tree.dofs), fill, is_parted=True)

    def share(self, name: str, body: Callable[[], object]) -> None:
        """Does the body, in a routine where several threads may."""
        if self._has_team:
            self.program.routine(name, body)
        else:
            body()

    def _by_parts(self, size: int, arrays: Sequence[Array], body: Callable[..., object]) -> None:
        """The body for parts of the arrays' rows, of `size` numbers each; one thread does all of a row."""
        if not self._has_team:
            body(*arrays)
            return

        def part(number: Place, _: Vector) -> Vector:
            body(*(one.part(number * size, size) for one in arrays))
            return []

        for_each(self.program, len(arrays[0]) // size, part, is_parted=True)

    def clear(self, rows: Array) -> None:
        """Sets them to 0, row 0, too."""

        def clear(row: Place, _: Vector) -> Vector:
            rows.store(row, [0.0] * len(rows))
            return []

        for_each(self.program, len(self.tree.dofs) + 1, clear)

    def _move_written_out(self, vector: Vector) -> None:
        moved = {0: _STILL}
        self.motions.store(0, _STILL)
        for i, number in enumerate(vector):
            moved[i + 1] = add(moved[_above(self.tree, i)], scale(self.axes.row(i + 1), number))
            self.motions.store(i + 1, moved[i + 1])

    def _on_dofs_written_out(self, wrenches: Array) -> Vector:
        size = len(self.tree.dofs)
        carried = [wrenches.row(row) for row in range(size + 1)]
        for i in reversed(range(size)):
            above = _above(self.tree, i)
            if above:
                carried[above] = add(carried[above], carried[i + 1])
        return [dot(self.axes.row(i + 1), carried[i + 1]) for i in range(size)]

    def _note_inertia(self, before: Place, _: Vector) -> Vector:
        body = before + 1
        placed = self._placed.row(body)
        rotation = [placed[:3], placed[3:6], placed[6:9]]
        own = [one.at(body) for one in self._own_inertias]
        self._inertias.store(body, about_centre(own, rotation, placed[9:], self._masses.at(body)))
        return []

    def _note_velocity(self, dof: Place, _: Vector) -> Vector:
        axis = self.axes.row(dof + 1)
        self._rates.store(dof + 1, cross_motion(self.velocities.row(self._before_joint.at(dof)), axis))
        change = scale(axis, self._vector.row(dof)[0])
        self.velocities.store(dof + 1, add(self.velocities.row(self._above.at(dof)), change))
        return []

    def _note(self, vector: Vector) -> None:
        for i, number in enumerate(vector):
            self._vector.store(i, [number])

    def _carry(self, rows: Array) -> None:
        """To each row, those that it carries."""
        last = len(self.tree.dofs) - 1

        def carry(before: Place, _: Vector) -> Vector:
            dof = before * -1 + last
            rows.add(self._above.at(dof), rows.row(dof + 1))
            return []

        for_each(self.program, len(self.tree.dofs), carry)


def lower(k: int, m: int) -> int:
    """The index of a symmetric matrix's entry among those of its lower triangle, row by row."""
    high, low = max(k, m), min(k, m)
    return high * (high + 1) // 2 + low


def rows_of(tree: Tree) -> list[int]:
    """By body, its row."""
    found = [0]
    for number, body in enumerate(tree.bodies[1:], 1):
        own = [i for i, dof in enumerate(tree.dofs) if dof.body == number]
        found.append(own[-1] + 1 if own else found[body.parent])
    return found


def _above(tree: Tree, dof: int) -> int:
    """The row that carries a degree of freedom's."""
    ancestors = tree.dofs[dof].ancestors
    return ancestors[-1] + 1 if ancestors else 0


def _before_joints(tree: Tree) -> list[int]:
    """By degree of freedom, the row with whose velocity its axis changes: those of a ball change together,
    and a free joint's rotations with the velocity after its translations."""
    found = list[int]()
    for body in tree.bodies:
        for joint in body.joints:
            first = _above(tree, joint.dof)
            match joint.kind:
                case "free":
                    found += [first] * 3 + [joint.dof + 3] * 3
                case "ball":
                    found += [first] * 3
                case _:
                    found.append(first)
    return found
