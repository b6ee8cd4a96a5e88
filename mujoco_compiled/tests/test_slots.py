"""A program in sections computes the same bits as in one piece."""

from collections.abc import Callable

import numpy as np
import pytest

from mujoco_compiled.code.cpu_function import cpu_function
from mujoco_compiled.code.gpu_kernel import gpu_kernel
from mujoco_compiled.code.machine_code import loaded, machine_code
from mujoco_compiled.code.ptx import ptx
from mujoco_compiled.code.slots import Section, slotted
from mujoco_compiled.program.arithmetic import Number, Vector, cosine, dot, maximum, select, sine, total
from mujoco_compiled.program.flow import repeat, where_needed
from mujoco_compiled.program.memory import column, for_each, rows, where_any
from mujoco_compiled.program.program import Place, Program
from mujoco_compiled.substep import SubstepState, control_step, read_model
from mujoco_compiled.tests.extra import extra
from mujoco_compiled.tests.states import converged, of_all, states

WIDTH = 8
NUM_ENVS = 19  # Two whole vectors and a part of one.
Values = dict[str, np.ndarray]
Body = Callable[[list[Number]], list[Number]]


def outputs(program: Program, given: Values, section_size: int | None) -> list[np.ndarray]:
    """given: by input, [environments, size]."""
    inputs = [np.ascontiguousarray(values, np.float32) for values in given.values()]
    found = [np.full((len(inputs[0]), len(one)), np.inf, np.float32) for one in program.outputs.values()]
    modules = cpu_function(program, "run", WIDTH, section_size, num_parts=3)
    code = machine_code(modules, 1 if section_size else 2)
    loaded(code, "run", len(inputs) + len(found))(0, len(inputs[0]), *inputs, *found)
    return found


def swapped(x: list[Number]) -> list[Number]:
    def body(carried: list[Number]) -> tuple[list[Number], Number]:
        a, b, c = carried
        return [b, a, c + a * b], c < 4.0

    return repeat(7, body, [x[0], x[1], 0.0])


def nested(x: list[Number]) -> list[Number]:
    """Numbers from before the loops are used in them, and after them."""
    outside = [one * x[0] for one in x]

    def outer(carried: list[Number]) -> tuple[list[Number], Number]:
        a, b = carried
        early = [sine(one) * a for one in outside]

        def inner(own: list[Number]) -> tuple[list[Number], Number]:
            (c,) = own
            return [0.5 * c + dot(early, outside)], absent(c) < 2.0

        (c,) = repeat(5, inner, [b])
        (d,) = where_needed(a < c, lambda: [total(cosine(one) + c for one in early)], lambda _: [b])
        return [0.25 * d + a, maximum(c, d)], a < 3.0

    return [*repeat(4, outer, [x[1], x[2]]), total(outside)]


def absent(x: Number) -> Number:
    """A difference of which one term is chosen: LLVM fuses through the choice."""
    return x - select(x < 1.0, x * x, 0.0)


def branches(x: list[Number]) -> list[Number]:
    def deeper() -> list[Number]:
        y = [one * one - x[1] for one in x]
        return where_needed(x[1] < 0.0, lambda: [dot(y, x), y[0]], lambda _: [y[1], 3.0])

    a, b = where_needed(x[0] < 0.0, deeper, lambda _: [x[2], 1.0])
    return [a, b, a * b + x[0]]


def unused(x: list[Number]) -> list[Number]:
    sine(x[0] * x[1])
    repeat(3, lambda own: ([own[0] * x[1]], own[0] < 1.0), [x[2]])
    return [x[0], 2.0 * x[1], x[0]]


@pytest.mark.parametrize("section_size", [1, 2, 3, 7, 1_000])
@pytest.mark.parametrize("body", [swapped, nested, branches, unused])
def test_sections_change_no_bit(body: Body, section_size: int) -> None:
    program = Program()
    program.output("y", body(list(program.inputs("x", 3))))
    given = {"x": np.random.default_rng(0).normal(size=(NUM_ENVS, 3))}
    (whole,), (parted,) = outputs(program, given, None), outputs(program, given, section_size)
    assert np.isfinite(whole).all()
    np.testing.assert_array_equal(whole.view(np.uint32), parted.view(np.uint32))


@pytest.mark.parametrize("name", ["half_cheetah", *extra("ant")])
def test_a_control_step_in_sections_has_the_same_bits(name: str) -> None:
    model = converged(name, implicit_damping=True)
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 4, 8, 1e-7
    datas = states(model)
    fields = {"qpos": model.nq, "qvel": model.nv, "qacc_warmstart": model.nv, "ctrl": model.nu}
    given = {name: np.transpose(of_all(datas, name)) for name in fields}
    program = Program()
    qpos, qvel, qacc, ctrl = (program.inputs(name, size) for name, size in fields.items())
    moved = control_step(read_model(model), 3, SubstepState(qpos, qvel, [], qacc), ctrl)
    for field in ("qpos", "qvel", "qacc"):
        program.output(field, getattr(moved, field))
    whole, parted = outputs(program, given, None), outputs(program, given, 250)
    for one, other in zip(whole, parted, strict=True):
        np.testing.assert_array_equal(one.view(np.uint32), other.view(np.uint32))


def program_with_a_list(*, restarts: bool) -> Program:
    """The sum of the weights below x, of those that are also below x / 2."""
    program = Program()
    (x,) = program.inputs("x", 1)
    weights, chosen = column(program, "weights", [0.5, 2.0, 4.0]), rows(program, "chosen", 3)

    def look(row: Place, _: Vector) -> Vector:
        where_any(x > weights.at(row), lambda: chosen.append(row))
        return []

    def look_again(number: Place, _: Vector) -> Vector:
        row = chosen.at(number)
        where_any(x > 2.0 * weights.at(row), lambda: chosen.append(row))
        return []

    chosen.clear()
    for_each(program, 3, look)
    if restarts:
        length = chosen.restart()
    else:
        length = chosen.length()
        chosen.clear()
    for_each(program, length, look_again)
    y = for_each(program, chosen.length(), lambda row, now: [now[0] + weights.at(chosen.at(row))], [x])
    program.output("y", [sine(sine(y[0]))])
    return program


@pytest.mark.parametrize("section_size", [None, 1, 5])
def test_a_list_is_gone_through_and_filled_again_in_sections(section_size: int | None) -> None:
    # Alone: 5 is above 0.5, 2 and 4, and 2.5 above 0.5 and 2.
    (found,) = outputs(program_with_a_list(restarts=True), {"x": np.array([[5.0]], np.float32)}, section_size)
    np.testing.assert_allclose(found, [[np.sin(np.sin(7.5))]], rtol=1e-5)


def test_sections_refuse_a_length_that_is_read_before_its_list_changes() -> None:
    with pytest.raises(ValueError, match="A list changes between"):
        slotted(program_with_a_list(restarts=False), section_size=5)


def test_slots_are_used_again() -> None:
    program = Program()
    (x,) = program.inputs("x", 1)
    for _ in range(100):
        x = sine(x)
    program.output("y", [x])
    found = slotted(program, section_size=10)
    # 102 operations. In each section one number comes from the section before, and one is for the next.
    assert len(found.parts) == 11
    assert all(isinstance(one, Section) for one in found.parts)
    assert found.num_slots == 2


def test_a_kernel_keeps_its_slots_in_the_memory_of_the_thread() -> None:
    program = Program()
    program.output("y", nested(list(program.inputs("x", 3))))
    code = ptx(gpu_kernel(program, "run", section_size=5), "9.0")
    assert all(word in code for word in ("ld.local", "st.local", "call.uni"))
    assert ".local" not in ptx(gpu_kernel(program, "run"), "9.0")
