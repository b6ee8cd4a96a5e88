"""Loops over tables, lists and arrays: NumPy runs them as written, and machine code for several at once."""

import numpy as np
import pytest

from mujoco_compiled.program.arithmetic import Number, Vector
from mujoco_compiled.program.interpret import interpret
from mujoco_compiled.program.memory import (
    Lookup,
    Table,
    array,
    column,
    for_each,
    integers,
    overflow,
    rows,
    where_any,
)
from mujoco_compiled.program.program import Place, Program
from mujoco_compiled.tests.test_machine_code import run

WEIGHTS = [0.5, 2.0, 4.0]
GIVEN = np.array([0.0, 1.0, -3.0, 8.0, 0.25], np.float32)


def both(program: Program) -> dict[str, np.ndarray]:
    """The outputs of machine code, which must be those of NumPy."""
    found = run(program, {"x": [GIVEN]})
    for name, values in interpret(program, {"x": [GIVEN]}).items():
        expected = [np.broadcast_to(value, GIVEN.shape) for value in values]
        np.testing.assert_array_equal(found[name], np.array(expected, np.float32))
    return found


def test_a_loop_reads_the_models_numbers_and_an_environments_own() -> None:
    program = Program()
    (x,) = program.inputs("x", 1)
    weights, own = column(program, "weights", WEIGHTS), column(program, "own", [x, 2.0 * x, 1.0])

    def add(row: Place, now: Vector) -> Vector:
        return [now[0] + weights.at(row) * own.at(row)]

    program.output("sum", for_each(program, len(WEIGHTS), add, [0.0]))
    np.testing.assert_array_equal(both(program)["sum"][0], 4.5 * GIVEN + 4.0)


def test_tables_of_one_name_have_each_their_own_numbers() -> None:
    program = Program()
    (x,) = program.inputs("x", 1)
    one, other = (column(program, "weights", values) for values in (WEIGHTS, WEIGHTS[::-1]))

    def add(row: Place, now: Vector) -> Vector:
        return [now[0] + x * one.at(row), now[1] + other.at(row) * one.at(row)]

    program.output("sums", for_each(program, len(WEIGHTS), add, [0.0, 0.0]))
    np.testing.assert_array_equal(both(program)["sums"], [6.5 * GIVEN, np.full(5, 8.0)])


def test_what_a_loop_adds_to_a_chosen_row_stays_there() -> None:
    program = Program()
    (x,) = program.inputs("x", 1)
    held, targets = array(program, "held", 2, 2), integers(program, "targets", [1, 0, 1])
    for row in range(2):
        held.store(row, [x, 10.0])

    def add(row: Place, _: Vector) -> Vector:
        held.add(targets.at(row), [1.0], first=1)
        return []

    for_each(program, 3, add)
    program.output("held", [*held.row(0), *held.row(1)])
    expected = [GIVEN, np.full(5, 11.0), GIVEN, np.full(5, 12.0)]
    np.testing.assert_array_equal(both(program)["held"], expected)


def above(program: Program, x: Number, most: int) -> Vector:
    """How many of three weights the environments together are above, their sum, and what was lost."""
    chosen, weights = rows(program, "chosen", most), column(program, "weights", WEIGHTS)

    def look(row: Place, _: Vector) -> Vector:
        where_any(x > weights.at(row), lambda: chosen.append(row))
        return []

    def add(row: Place, now: Vector) -> Vector:
        return [now[0] + 1.0, now[1] + weights.at(chosen.at(row))]

    chosen.clear()
    for_each(program, len(WEIGHTS), look)
    return [*for_each(program, chosen.length(), add, [0.0, 0.0]), overflow(program)]


def test_a_list_has_what_one_of_those_that_are_computed_together_needs() -> None:
    program = Program()
    program.output("found", above(program, program.inputs("x", 1)[0], most=3))
    # `run` computes the last environment alone.
    found = run(program, {"x": [GIVEN]})["found"]
    np.testing.assert_array_equal(found, [[3, 3, 3, 3, 0], [6.5, 6.5, 6.5, 6.5, 0], [0] * 5])
    program = Program()
    program.output("found", above(program, program.inputs("x", 1)[0], most=3))
    np.testing.assert_array_equal(interpret(program, {"x": [GIVEN]})["found"], [3, 6.5, 0])


def test_a_list_that_overflows_tells_so_and_keeps_what_it_holds() -> None:
    program = Program()
    program.output("found", above(program, program.inputs("x", 1)[0], most=2))
    found = run(program, {"x": [GIVEN]})["found"]
    np.testing.assert_array_equal(found, [[2, 2, 2, 2, 0], [2.5, 2.5, 2.5, 2.5, 0], [3, 3, 3, 3, 0]])


def test_each_environment_reads_a_row_of_its_own() -> None:
    program = Program()
    (x,) = program.inputs("x", 1)
    weights = Lookup("weights", np.array(WEIGHTS))
    program.output("weight", [weights.at(0.5 * x)])
    # Half of 8 is beyond the table, and half of -3 before it.
    np.testing.assert_array_equal(both(program)["weight"][0], [0.5, 0.5, 0.5, 4.0, 0.5])
    np.testing.assert_array_equal(weights.at(np.array([np.nan, 1.0, -2.0])), [0.5, 2.0, 0.5])


def summed(program: Program, x: Number) -> Vector:
    """A routine called twice: sums of groups of rows, and halves of three rows, carried from row to row."""
    groups = Table(program, "groups", [[(0, 2)], [], [(1, 1), (0, 0)]])
    given, found = array(program, "given", 3, space="shared"), array(program, "found", 3, space="common")
    pairs = array(program, "pairs", 3, 2, space="common")

    def work() -> None:
        def group(number: Place, _: Vector) -> Vector:
            def add(row: Place, now: Vector) -> Vector:
                one, other = groups.at(row)
                return [now[0] + given.row(one)[0] * given.row(other)[0]]

            found.store(number, groups.for_each(number, add, [0.0]))
            return []

        def half(place: Place, _: Vector) -> Vector:
            own = pairs.part(place, 1)

            def carry(row: Place, _: Vector) -> Vector:
                own.add(row + 1, own.row(row))
                return []

            return for_each(program, 2, carry)

        for_each(program, 3, group, is_parted=True)
        for_each(program, 2, half, is_parted=True)

    for row in range(3):
        given.store(row, [x + float(row)])
        pairs.store(row, [x, 1.0])
    program.routine("work", work)
    first = [found.row(row)[0] for row in range(3)]
    given.store(0, [0.0])
    program.routine("work", work)
    return [*first, *(found.row(row)[0] for row in range(3)), *pairs.row(2)]


def test_a_routine_works_on_what_lies_in_memory_whenever_it_is_called() -> None:
    program = Program()
    program.output("found", summed(program, program.inputs("x", 1)[0]))
    assert len(program.routines) == 1
    x, one, two = GIVEN, GIVEN + 1.0, GIVEN + 2.0
    expected = [x * two, 0 * x, one**2 + x**2, 0 * x, 0 * x, one**2]
    # Sums of sums: after the first call x, 2 x, 3 x, and after the second x, 3 x, 6 x.
    np.testing.assert_allclose(both(program)["found"], [*expected, 6.0 * x, np.full(5, 6.0)])


def test_a_routine_must_not_work_on_numbers_that_other_threads_do_not_see() -> None:
    program = Program()
    own = array(program, "own", 1)
    with pytest.raises(ValueError, match="'work' works on numbers of one thread"):
        program.routine("work", lambda: own.store(0, [1.0]))
