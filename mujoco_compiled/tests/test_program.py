"""A program that the stages write computes the same as the stages."""

import numpy as np
import pytest

from mujoco_compiled.program.arithmetic import Number, select, sqrt
from mujoco_compiled.program.flow import needed, repeat, where_needed
from mujoco_compiled.program.interpret import interpret
from mujoco_compiled.program.program import Assign, Branch, Program
from mujoco_compiled.substep import SubstepState, read_model, substep
from mujoco_compiled.tests.states import converged, of_all, states


def operations(program: Program) -> list[str]:
    return [one.operation for one in program.statements if isinstance(one, Assign)]


def test_constants_and_signs_cost_nothing_and_equal_operations_are_written_once() -> None:
    program = Program()
    x, y = program.inputs("x", 2)
    assert (x * 0.0, x * 1.0, x - x) == (0.0, x, 0.0)
    program.output("sum", [x * y - (-y) * x, -(y * x) + 1.0 * (x * y), 0.0 / x])
    assert operations(program) == ["input", "input", "multiply", "constant", "multiply", "constant"]
    found = interpret(program, {"x": [np.array([3.0]), np.array([5.0])]})["sum"]
    assert [value.item() for value in found] == [30.0, 0.0, 0.0]


def test_an_environment_leaves_a_loop_when_nothing_improves() -> None:
    def newton(carried: list[Number]) -> tuple[list[Number], Number]:
        """Towards the square root of 2."""
        (x,) = carried
        after = 0.5 * (x + 2.0 / x)
        return [after], sqrt((after - x) * (after - x)) > 1e-3

    program = Program()
    program.output("root", repeat(20, newton, program.inputs("x", 1)))
    begun = np.array([1.0, 100.0, np.sqrt(2.0)])
    (written,), (computed,) = interpret(program, {"x": [begun]})["root"], repeat(20, newton, [begun])
    np.testing.assert_array_equal(written, computed)


def test_both_sides_of_a_choice_are_written() -> None:
    program = Program()
    (x,) = program.inputs("x", 1)
    program.output("chosen", [select(x < 0.0, -x, 2.0)])
    assert interpret(program, {"x": [np.array([-3.0, 3.0])]})["chosen"][0].tolist() == [3.0, 2.0]


def test_a_branch_leaves_environments_as_they_are_where_it_is_not_needed() -> None:
    program = Program()
    x, y = program.inputs("x", 2)

    def chosen(x: Number, y: Number) -> list[Number]:
        return where_needed(x > 0.0, lambda: [sqrt(x), x * y, 7.0], lambda _: [-1.0, y, 7.0])

    found = chosen(x, y)
    assert found[2] == 7.0
    program.output("chosen", found)
    begun = [np.array([4.0, -4.0, 9.0]), np.array([2.0, 3.0, 5.0])]
    with np.errstate(invalid="ignore"):
        (root, scaled, _), expected = interpret(program, {"x": begun})["chosen"], chosen(*begun)
    np.testing.assert_array_equal(root, [2.0, -1.0, 3.0])
    np.testing.assert_array_equal(scaled, [8.0, 3.0, 45.0])
    np.testing.assert_array_equal([root, scaled], expected[:2])


def test_what_a_branch_needs_for_nothing_goes() -> None:
    program = Program()
    x, y = program.inputs("x", 2)
    first, _ = where_needed(x > y, lambda: [x * y, sqrt(x)], lambda _: [x, y])
    program.output("first", [first])
    (branch,) = (one for one in needed(program).statements if isinstance(one, Branch))
    assert len(branch.results) == 1
    assert [one.operation for one in branch.body if isinstance(one, Assign)] == ["multiply"]


@pytest.mark.parametrize("name", ["ant", "walker2d"])
def test_a_substep_that_was_written_down_is_the_substep(name: str) -> None:
    model = converged(name, implicit_damping=True)
    model.opt.iterations, model.opt.ls_iterations = 3, 6
    datas, ours = states(model), read_model(model)
    fields = {"qpos": model.nq, "qvel": model.nv, "qacc_warmstart": model.nv, "ctrl": model.nu}
    given = {name: of_all(datas, name) for name in fields}
    program = Program()
    qpos, qvel, qacc, ctrl = (program.inputs(name, size) for name, size in fields.items())
    moved = substep(ours, SubstepState(qpos, qvel, [], qacc), ctrl)
    for field in ("qpos", "qvel", "qacc"):
        program.output(field, getattr(moved, field))
    qpos, qvel, qacc, ctrl = given.values()
    found, expected = interpret(program, given), substep(ours, SubstepState(qpos, qvel, [], qacc), ctrl)
    for field in ("qpos", "qvel", "qacc"):
        np.testing.assert_allclose(found[field], getattr(expected, field), rtol=1e-9, atol=1e-9)
