"""Which threads of a kernel wait for each other, and where."""

import re

import pytest

from mujoco_compiled.code.gpu_kernel import block_of, gpu_kernel, most_shared, most_warps
from mujoco_compiled.code.long_writer import is_long
from mujoco_compiled.program.arithmetic import Number, Vector, sine
from mujoco_compiled.program.flow import repeat, where_needed
from mujoco_compiled.program.memory import array, for_each, where_any
from mujoco_compiled.program.program import Place, Program

WAIT, ASK = "call void @llvm.nvvm.barrier", "call i1 @llvm.nvvm.barrier"


def chain(x: Number, length: int) -> Number:
    for _ in range(length):
        x = sine(x)
    return x


def program_of(length: int) -> Program:
    """A loop of about this length, in it another loop of 50 operations and a branch of 3,000."""
    program = Program()

    def body(carried: list[Number]) -> tuple[list[Number], Number]:
        x = chain(carried[0], length)
        (y,) = repeat(4, lambda own: ([chain(own[0], 50)], own[0] < 1.0), [x])
        return where_needed(y < 0.5, lambda: [chain(y, 3_000)], lambda _: [y]), y < 2.0

    program.output("y", repeat(5, body, list(program.inputs("x", 1))))
    return program


@pytest.mark.extra
def test_warps_stay_together_in_a_large_program() -> None:
    program = program_of(20_000)
    code = gpu_kernel(program, "run")
    assert most_warps(program, None) == 8
    assert '"nvvm.maxntid"="256"' in code
    # Before the loop, after each thousand of its chain, before and after the branch.
    assert code.count(WAIT) == 1 + 20 + 2
    # In the long loop alone.
    assert code.count(ASK) == 1


def test_threads_do_not_wait_where_others_may_not_come() -> None:
    """Waiting in a branch, or in a loop that each thread leaves for itself, would never end."""
    lines = gpu_kernel(program_of(20_000), "run").splitlines()
    waits = [number for number, line in enumerate(lines) if WAIT in line or ASK in line]
    branches = [
        (number, lines.index(f"{after[1]}:"))
        for number, line in enumerate(lines)
        if (after := re.search(r"br i1 %\w+, label %\w+, label %(\w+)$", line))
    ]
    # Of both loops and of the branch; outputs are written in blocks of their own.
    (outer, *_), *inner = [one for one in branches if one[1] - one[0] > 50]
    assert len(inner) == 2
    assert min(waits) < outer
    assert not [wait for first, last in inner for wait in waits if first < wait < last]


def test_threads_of_a_small_program_go_alone() -> None:
    program = program_of(1_000)
    code = gpu_kernel(program, "run")
    assert most_warps(program, None) == 1
    assert '"nvvm.maxntid"="32"' in code
    assert WAIT not in code
    assert ASK not in code


@pytest.mark.extra
def test_a_long_program_with_routines_stays_in_one_piece() -> None:
    """In sections its threads would go alone, and each compute its routines."""
    program, with_routine = program_of(45_000), program_with_a_routine(100)
    with_routine.output("z", [chain(with_routine.inputs("w", 1)[0], 45_000)])
    assert is_long(program)
    assert not is_long(with_routine)


@pytest.mark.extra
def test_a_program_in_sections_goes_alone() -> None:
    program = program_of(20_000)
    code = gpu_kernel(program, "run", section_size=2_000)
    assert most_warps(program, 2_000) == 1
    assert WAIT not in code
    assert ASK not in code


def program_with_a_routine(size: int) -> Program:
    """The routine doubles numbers that all threads see, in a loop that environments leave one by one."""
    program = Program(has_team=True)
    held, far = array(program, "held", size, space="shared"), array(program, "far", 4, space="common")

    def add(row: Place, _: Vector) -> Vector:
        held.add(row, far.row(row))
        return []

    def double() -> None:
        for_each(program, 4, add, is_parted=True)

    def body(carried: list[Number]) -> tuple[list[Number], Number]:
        held.store(0, carried)
        far.store(0, carried)
        program.routine("double", double)
        (y,) = held.row(0)
        return [y], y < 10.0

    program.output("y", repeat(5, body, list(program.inputs("x", 1))))
    return program


def test_the_threads_of_a_block_share_a_routine() -> None:
    program = program_with_a_routine(100)
    block = block_of(program, None, "9.0", is_lean=False)
    code = gpu_kernel(program, "run", block=block)
    assert '"nvvm.maxntid"="256"' in code
    # All environments go through the loop as long as one of them does.
    assert code.count("call i1 @llvm.nvvm.vote.any.sync(i32 -1, i1") == 1
    assert code.count("define internal void") == 2
    assert "phi i64 [ %part, " in code
    assert ", %num_parts" in code


@pytest.mark.parametrize(
    ("size", "card", "is_lean", "num_envs", "near"),
    [
        (100, "9.0", False, 32, 4),  # all is near
        (100, "9.0", True, 32, 0),  # blocks have to share a processor
        (1_815, "9.0", False, 16, 4),  # with 32, nothing would be
        (1_815, "9.0", True, 16, 0),
        (1_815, "8.0", False, 16, 4),
        (1_815, "8.9", False, 8, 4),
        (3_165, "8.9", False, 8, 0),  # 99 KiB, less what kernels have besides, are 8 times 3,166 numbers
    ],
)
def test_a_block_has_as_many_environments_as_fit(
    size: int, card: str, is_lean: bool, num_envs: int, near: int
) -> None:
    block = block_of(program_with_a_routine(size), None, card, is_lean=is_lean)
    assert block is not None
    assert (block.num_envs, block.near) == (num_envs, near)
    assert block.shared_bytes == 4 * num_envs * (size + near) <= most_shared(card)


def test_threads_go_alone_where_too_much_is_shared_or_nothing() -> None:
    assert block_of(program_with_a_routine(8_000), None, "9.0", is_lean=False) is None
    assert "vote" not in gpu_kernel(program_with_a_routine(8_000), "run").split("define ptx_kernel")[1]
    assert block_of(program_of(1_000), None, "9.0", is_lean=False) is None


def test_no_routine_is_called_where_threads_go_their_own_ways() -> None:
    program = program_with_a_routine(100)
    block = block_of(program, None, "9.0", is_lean=False)
    (x,) = program.inputs("x", 1)
    where_any(x < 0.0, lambda: program.routine("double", lambda: None))
    with pytest.raises(ValueError, match="threads go their own ways"):
        gpu_kernel(program, "run", block=block)
