"""Constraint rows of C MuJoCo and of the stages, in the form that no order of rows changes."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from mujoco_compiled.constraints.cone import Cone
from mujoco_compiled.constraints.constraints import ConstraintState, constraint_rows, read_constraints
from mujoco_compiled.constraints.laws import Pyramid
from mujoco_compiled.constraints.rows import ConstraintRows, by_group, times
from mujoco_compiled.fields import NOMINAL, Own
from mujoco_compiled.program.arithmetic import Vector
from mujoco_compiled.smooth.dynamics import motion
from mujoco_compiled.smooth.kinematics import poses
from mujoco_compiled.smooth.tree import read_tree

Array = NDArray[np.float64]


def rows_of(model: mujoco.MjModel, datas: list[mujoco.MjData], own: Own = NOMINAL) -> ConstraintRows:
    """Our rows, for all states at once."""
    qpos: Vector = list(np.stack([data.qpos for data in datas], axis=1))
    qvel: Vector = list(np.stack([data.qvel for data in datas], axis=1))
    tree = read_tree(model, own)
    at = poses(tree, qpos)
    moving = motion(tree, at, qvel)
    return constraint_rows(tree, read_constraints(model, own), at, moving, ConstraintState(qpos, qvel))


def ours(rows: ConstraintRows, num_states: int, num_dofs: int) -> tuple[Array, Array]:
    """Jᵀ D J [states, nv, nv] and Jᵀ D aref [states, nv], with each edge of a pyramid as a row."""
    pressed, pulled = np.zeros((num_states, num_dofs, num_dofs)), np.zeros((num_states, num_dofs))
    entries = [times(rows, list(one)) for one in np.eye(num_dofs)]
    for group, places in by_group(rows, list(range(len(entries[0])))):
        directions = np.zeros((group.size, num_states, num_dofs))
        for direction, place in zip(directions, places, strict=True):
            for dof in range(num_dofs):
                direction[:, dof] = entries[dof][place]
        reference = np.stack([np.broadcast_to(x, num_states) for x in group.reference])
        stiffness = _stiffness(group.law, len(directions))
        for mixture, own in zip(_mixtures(group.law, len(directions), num_states), stiffness, strict=True):
            row, wanted = np.einsum("ks,ksi->si", mixture, directions), (mixture * reference).sum(axis=0)
            scaled = np.broadcast_to(own, num_states)[:, None] * row
            pressed += scaled[:, :, None] * row[:, None, :]
            pulled += scaled * wanted[:, None]
    return pressed, pulled


def theirs(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """The same of C MuJoCo, [nv, nv] and [nv]."""
    jacobian = np.zeros((data.nefc, model.nv))
    if mujoco.mj_isSparse(model):
        structure = (data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
        mujoco.mju_sparse2dense(jacobian, data.efc_J, *structure)
    elif data.nefc:
        jacobian[:] = data.efc_J.reshape(data.nefc, model.nv)
    return jacobian.T @ np.diag(data.efc_D) @ jacobian, jacobian.T @ (data.efc_D * data.efc_aref)


def assert_same_rows(
    model: mujoco.MjModel, datas: list[mujoco.MjData], own: Own = NOMINAL, accuracy: float = 1e-9
) -> None:
    found = ours(rows_of(model, datas, own), len(datas), model.nv)
    for place, mine in enumerate(found):
        expected = np.stack([theirs(model, data)[place] for data in datas])
        axes = tuple(range(1, expected.ndim))
        apart, largest = np.abs(mine - expected).max(axis=axes), np.abs(expected).max(axis=axes)
        np.testing.assert_array_less(apart, accuracy * largest + 1e-11)


def _mixtures(law: object, num_directions: int, num_states: int) -> Array:
    """By row, a coefficient for each direction and state."""
    units = np.repeat(np.eye(num_directions)[:, :, None], num_states, axis=2)
    if not isinstance(law, Pyramid):
        return units
    edges = [sign * mu * units[k + 1] for k, mu in enumerate(law.friction) for sign in (1, -1)]
    return units[0] + np.stack(edges)


def _stiffness(law: object, num_directions: int) -> list[Array]:
    """By row."""
    stiffness = getattr(law, "stiffness")  # noqa: B009
    if isinstance(law, Pyramid):
        return [stiffness] * (2 * len(law.friction))
    if isinstance(law, Cone):
        return [stiffness, *(stiffness * (mu / law.slope_of_cone) ** 2 for mu in law.friction)]
    return [stiffness] * num_directions
