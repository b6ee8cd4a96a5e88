"""Machine code computes what the program says, in float32 and in every lane."""

import numpy as np
import pytest

from mujoco_compiled.code.cpu_function import cpu_function
from mujoco_compiled.code.machine_code import loaded, machine_code
from mujoco_compiled.program.arithmetic import Number, sine, sqrt
from mujoco_compiled.program.flow import repeat, where_needed
from mujoco_compiled.program.interpret import interpret
from mujoco_compiled.program.program import Program
from mujoco_compiled.substep import SubstepState, control_step, read_model
from mujoco_compiled.tests.extra import extra
from mujoco_compiled.tests.states import NUM_STATES, converged, of_all, states

WIDTH = 8


def run(program: Program, given: dict[str, list[np.ndarray]]) -> dict[str, np.ndarray]:
    """The outputs [number, environments]."""
    inputs = [np.ascontiguousarray(np.transpose(values), np.float32) for values in given.values()]
    num_envs = len(inputs[0])
    outputs = [np.full((num_envs, len(one)), np.inf, np.float32) for one in program.outputs.values()]
    code = loaded(machine_code(cpu_function(program, "run", WIDTH)), "run", len(inputs) + len(outputs))
    # The last environment of the first call, and the only one of the second, are not a whole vector.
    code(0, num_envs - 1, *inputs, *outputs)
    assert all(np.isinf(values[-1]).all() for values in outputs)
    code(num_envs - 1, num_envs, *inputs, *outputs)
    return {name: values.T for name, values in zip(program.outputs, outputs, strict=True)}


def test_each_lane_leaves_a_loop_for_itself() -> None:
    def halve(carried: list[Number]) -> tuple[list[Number], Number]:
        (x,) = carried
        return [0.5 * x], x > 4.0

    program = Program()
    program.output("x", repeat(10, halve, program.inputs("x", 1)))
    begun = [np.array([1, 2, 4, 5, 8, 9, 64, 1e6], np.float32)]
    # Halved once too often, as the loop looks after the work is done, and at most ten times.
    expected = [0.5, 1.0, 2.0, 1.25, 2.0, 1.125, 2.0, 1e6 / 1024]
    np.testing.assert_array_equal(run(program, {"x": begun})["x"][0], np.array(expected, np.float32))


def test_a_branch_changes_only_lanes_that_need_it() -> None:
    def once(carried: list[Number]) -> tuple[list[Number], Number]:
        (x,) = carried
        (y,) = where_needed(x > 4.0, lambda: [sqrt(x) + 0.0 * sine(x)], lambda _: [x])
        return [y], True

    program = Program()
    (x,) = repeat(2, once, program.inputs("x", 1))
    program.output("x", where_needed(x < 0.0, lambda: [-x], lambda _: [x]))
    begun = [np.array([1.0, -2.0, 16.0, 625.0, 81.0, 4.0, 0.0, -1e6, 25.0], np.float32)]
    expected = [1.0, 2.0, 4.0, 5.0, 3.0, 4.0, 0.0, 1e6, 5.0**0.5]
    np.testing.assert_array_equal(run(program, {"x": begun})["x"][0], np.array(expected, np.float32))


@pytest.mark.parametrize("name", ["half_cheetah", *extra("ant")])
def test_two_substeps_in_machine_code_are_two_substeps(name: str) -> None:
    model = converged(name, implicit_damping=True)
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 15, 25, 1e-7
    datas = states(model)
    fields = {"qpos": model.nq, "qvel": model.nv, "qacc_warmstart": model.nv, "ctrl": model.nu}
    given = {name: of_all(datas, name) for name in fields}
    program = Program()
    qpos, qvel, qacc, ctrl = (program.inputs(name, size) for name, size in fields.items())
    moved = control_step(read_model(model), 2, SubstepState(qpos, qvel, [], qacc), ctrl)
    for field in ("qpos", "qvel"):
        program.output(field, getattr(moved, field))
    exact, found = interpret(program, given), run(program, given)
    for field, atol in (("qpos", 1e-5), ("qvel", 1e-3)):
        expected = np.stack(np.broadcast_arrays(*exact[field]))
        assert expected.shape[1] == NUM_STATES
        np.testing.assert_allclose(found[field], expected, rtol=0, atol=atol)
