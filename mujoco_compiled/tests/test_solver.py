"""The solver on problems whose outcome can be written down."""

import mujoco

from mujoco_compiled.constraints.laws import OneSided
from mujoco_compiled.constraints.rows import ConstraintRows, RowGroup
from mujoco_compiled.constraints.solver import Settings, SolverProblem, acceleration
from mujoco_compiled.fields import NOMINAL
from mujoco_compiled.smooth.inertia import WrittenOut
from mujoco_compiled.smooth.tree import read_tree

SLIDE = "<mujoco><worldbody><body><joint type='slide'/><geom size='0.1'/></body></worldbody></mujoco>"


def solved(*, line_search_iterations: int) -> float:
    """The acceleration a of 1 kg under -10 N, from 0, in one iteration.

    A row of 100 kg pushes where a < -1, one of 1e6 kg where a < -9.
    """
    tree = read_tree(mujoco.MjModel.from_xml_string(SLIDE), NOMINAL)
    groups = [
        RowGroup([{0: 1.0}], [reference], OneSided(stiffness))
        for reference, stiffness in ((-1.0, 100.0), (-9.0, 1e6))
    ]
    problem = SolverProblem(
        WrittenOut(tree, {(0, 0): 1.0}), [-10.0], [-10.0], ConstraintRows(groups, tree, [], [])
    )
    settings = Settings(1, line_search_iterations, 1e-12, 0.01, 1.0)
    return float(acceleration(problem, [0.0], settings)[0])


def test_a_line_search_that_is_cut_off_where_the_cost_is_higher_leaves_the_guess() -> None:
    # Newton's first step, of no row, is to -10, and the next about to -9. There the first row costs
    # 100 / 2 · 8² = 3200, and at 0 the whole is 10² / 2 = 50.
    assert solved(line_search_iterations=1) == 0.0


def test_a_line_search_that_is_not_cut_off_ends_where_the_forces_are_in_balance() -> None:
    # a = -10 + 100 (-1 - a).
    assert abs(solved(line_search_iterations=20) + 110.0 / 101.0) < 1e-6
