"""M = Lᵀ D L of a symmetric matrix with few entries, and linear equations with it.

Source: Featherstone (2008), section 6.5.
"""

from dataclasses import dataclass

from mujoco_compiled.program.arithmetic import Number, Vector, total
from mujoco_compiled.smooth.dynamics import Entries
from mujoco_compiled.smooth.tree import Tree


@dataclass(frozen=True)
class Factor:
    """lower: L's entries below its diagonal of ones. inverse_diagonal: 1 / D [nv]. As MuJoCo's `qLD`."""

    lower: Entries
    inverse_diagonal: list[Number]


def factorize(tree: Tree, matrix: Entries) -> Factor:
    """Eliminates from the leaves to the root, which creates no entry in a matrix with the tree's alone."""
    left, lower = dict(matrix), Entries()
    inverse: list[Number] = [0.0] * len(tree.dofs)
    for k in reversed(range(len(tree.dofs))):
        inverse[k] = 1.0 / left[k, k]
        bound = sorted(j for i, j in left if i == k and j < k)
        for place, i in enumerate(bound):
            factor = left[k, i] * inverse[k]
            lower[k, i] = factor
            for j in bound[: place + 1]:
                left[i, j] = left.get((i, j), 0.0) - factor * left[k, j]
    return Factor(lower, inverse)


def solve(tree: Tree, factor: Factor, right: Vector) -> Vector:
    """x [nv] with M x = right."""
    x = list(right)
    rows = [sorted(j for i, j in factor.lower if i == k) for k in range(len(tree.dofs))]
    for k in reversed(range(len(rows))):
        for j in rows[k]:
            x[j] = x[j] - factor.lower[k, j] * x[k]
    x = [value * inverse for value, inverse in zip(x, factor.inverse_diagonal, strict=True)]
    for k, row in enumerate(rows):
        for j in row:
            x[k] = x[k] - factor.lower[k, j] * x[j]
    return x


def multiply(tree: Tree, matrix: Entries, x: Vector) -> Vector:
    """M x [nv]."""
    terms: list[list[Number]] = [[] for _ in tree.dofs]
    for i, j in tree.entries:
        terms[i].append(matrix[i, j] * x[j])
        if i != j:
            terms[j].append(matrix[i, j] * x[i])
    return [total(own) for own in terms]
