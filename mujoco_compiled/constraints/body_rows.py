"""Products with rows that push a body against what stands still, through the motions of bodies.

Such a row's entry is how a degree of freedom's axis, a spatial motion, does work against a spatial force on
the body. So no entry need be there: motions are carried from the root to the leaves, forces and their
curvature from the leaves to the root. That takes fewer operations where many points of deep trees can touch.
Source: Featherstone (2008), chapter 6, whose composite inertias are summed in the same way.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from mujoco_compiled.constraints.laws import Law
from mujoco_compiled.program.arithmetic import Matrix, Number, Vector, add, dot, scale, total
from mujoco_compiled.smooth.tree import Tree
from mujoco_compiled.smooth.tree_loops import lower

Terms = dict[tuple[int, int], list[Number]]


@dataclass(frozen=True)
class BodyGroup:
    """wrenches: by direction, a spatial force [6] on the body about its tree's centre of mass.

    reference: by direction, the wanted acceleration. may_push: see `Group`.
    """

    body: int
    wrenches: Sequence[Vector]
    reference: Vector
    law: Law
    may_push: Number = True

    @property
    def size(self) -> int:
        """The number of directions."""
        return len(self.wrenches)


def motions(tree: Tree, axes: Sequence[Vector], vector: Vector, bodies: Sequence[int]) -> dict[int, Vector]:
    """By body, and those that carry it: the motion [6] that a vector [nv] gives it."""
    needed = {carrier for body in bodies for carrier in _carriers(tree, body)}
    found: dict[int, Vector] = {0: [0.0] * 6}
    for body in sorted(needed):
        moved = found[tree.bodies[body].parent]
        for i in _own_dofs(tree, body):
            moved = add(moved, scale(axes[i], vector[i]))
        found[body] = moved
    return found


def on_dofs(tree: Tree, axes: Sequence[Vector], wrenches: Mapping[int, list[Vector]]) -> dict[int, Number]:
    """The forces on degrees of freedom of spatial forces [6] on bodies."""
    carried = _carried(tree, {body: _sum(own) for body, own in wrenches.items()})
    return {i: dot(axes[i], wrench) for body, wrench in carried.items() for i in _own_dofs(tree, body)}


def curvature(tree: Tree, axes: Sequence[Vector], bends: Mapping[int, list[Vector]]) -> Terms:
    """Terms of a matrix's lower triangle. bends: by body, what `bend` found."""
    found = Terms()
    for body, whole in _carried(tree, {body: _sum(several) for body, several in bends.items()}).items():
        rows = [[whole[lower(k, m)] for m in range(6)] for k in range(6)]
        for i in _own_dofs(tree, body):
            force = [dot(row, axes[i]) for row in rows]
            for j in (*tree.dofs[i].ancestors, i):
                found[i, j] = [dot(axes[j], force)]
    return found


def bend(wrenches: Sequence[Vector], weights: Matrix) -> Vector:
    """Wᵀ H W of wrenches W: the 21 entries of its lower triangle, row by row."""
    components = list(zip(*wrenches, strict=True))
    products = [[dot(row, component) for row in weights] for component in components]
    return [dot(components[m], products[k]) for k in range(6) for m in range(k + 1)]


def _carried(tree: Tree, own: dict[int, Vector]) -> dict[int, Vector]:
    """By body: its own numbers, and those of all bodies that it carries."""
    found = dict(own)
    for body in range(len(tree.bodies) - 1, 0, -1):
        above = tree.bodies[body].parent
        if body in found and above:
            found[above] = add(found[above], found[body]) if above in found else found[body]
    return found


def _sum(several: Sequence[Vector]) -> Vector:
    return [total(entries) for entries in zip(*several, strict=True)]


def _carriers(tree: Tree, body: int) -> Iterator[int]:
    while body:
        yield body
        body = tree.bodies[body].parent


def _own_dofs(tree: Tree, body: int) -> list[int]:
    return [i for i, dof in enumerate(tree.dofs) if dof.body == body]
