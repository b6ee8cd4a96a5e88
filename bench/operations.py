"""Shows what the engine `compiled` makes of a body, without running it.

`python -m bench.operations ant` prints the operations of one substep by stage. `--lines 10` prints ten of
them instead, and what these become by themselves: machine code of this processor, and PTX.
"""

import argparse
import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import llvmlite.binding as llvm
import mujoco

from core.environments import catalog
from core.environments.info import OUR_FAMILY
from core.physics.compiled import substep
from core.physics.compiled.code.cpu_function import cpu_function
from core.physics.compiled.code.gpu_kernel import gpu_kernel
from core.physics.compiled.code.machine_code import vector_width
from core.physics.compiled.code.ptx import ptx
from core.physics.compiled.program.program import Assign, Branch, Loop, Output, Program, Statement
from core.physics.compiled.refusal import check_covered
from core.physics.engine import Engine, SolverSettings
from core.physics.model import with_solver_of_compiled

_GIVEN = ("constant", "input")
_CARDS = "9.0"  # H100 and H200
# The functions that `substep` calls, with what they compute; what is left is its own.
_STAGES = {
    "poses": "positions and rotations of bodies",
    "motion": "axes, inertias and velocities",
    "mass_matrix": "mass matrix",
    "with_armature": "mass matrix",
    "bias_forces": "bias forces",
    "passive_forces": "springs and dampers",
    "tendon_forces": "springs and dampers",
    "weight_held": "gravity compensation",
    "drag_forces": "drag of a fluid",
    "driven": "actuators",
    "factorize": "factorisations",
    "solve": "solutions",
    "constraint_rows": "constraint rows",
    "acceleration": "solver",
    "implicit_inertia": "implicit damping",
    "multiply": "implicit damping",
    "add_slopes": "implicit damping",
    "integrated": "new positions",
}
_ARITHMETIC = r"^v\w*(add|sub|mul|div|sqrt)\w*ps"
_ARITHMETIC_OF_PTX = r"^(add|sub|mul|fma|div|rcp|sqrt|rsqrt|neg)\.\S*f32"
_DEPTHS = ("once a substep", "once an iteration", "once a step of the line search")


@dataclass
class StagedProgram(Program):
    """stages: by variable, the function that the substep called for it."""

    stages: dict[int, str] = field(default_factory=dict[int, str])

    def new_variable(self) -> int:
        number = super().new_variable()
        self.stages[number] = _stage()
        return number


def _stage() -> str:
    """The function that the innermost function of `substep` on the stack has called."""
    frame, inner = sys._getframe(), ""  # inspect.stack() would read source files each time.
    while frame is not None and frame.f_code.co_filename != substep.__file__:
        frame, inner = frame.f_back, frame.f_code.co_name
    return inner if frame is not None else ""


class _Found(Exception):
    """The model that an environment asks an engine for."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model


class _Asking:
    """Ends the making of the environment where it has its model."""

    name = "compiled"

    def __call__(
        self,
        model: mujoco.MjModel,
        num_substeps: int,
        derived: tuple[str, ...],
        *,
        accelerated: SolverSettings | None = None,
    ) -> Engine:
        raise _Found(with_solver_of_compiled(model, accelerated))


def model_of(environment: str) -> mujoco.MjModel:
    """What the engine `compiled` gets. Raises JobFailed if it cannot run it."""
    info = catalog.find(environment)
    if info.family != OUR_FAMILY:
        raise ValueError(f"{environment} brings its own physics.")
    try:
        catalog.make(info, catalog.parse_options(info, {}), _Asking())
    except _Found as found:
        check_covered(found.model)
        return found.model
    raise RuntimeError(f"{environment} asked for no engine.")


def substep_program(model: mujoco.MjModel) -> StagedProgram:
    """A control step of one substep, without derived fields."""
    program = StagedProgram()
    sizes = {"qpos": model.nq, "qvel": model.nv, "act": model.na, "qacc_warmstart": model.nv}
    state = substep.State(*(list(program.inputs(name, size)) for name, size in sizes.items()))
    ctrl = list(program.inputs("ctrl", model.nu))
    moved = substep.control_step(substep.read_model(model), 1, state, ctrl)
    program.output("qpos", moved.qpos)
    program.output("qvel", moved.qvel)
    program.output("qacc", moved.qacc)
    return program


def counts(program: StagedProgram) -> Counter[tuple[str, int]]:
    """Operations by stage and depth: the number of solver loops around them."""
    return Counter(
        (_STAGES.get(program.stages[one.target], "the rest"), depth)
        for one, depth in _operations(program.statements, -1)
    )


def _operations(statements: Sequence[Statement], depth: int) -> Iterator[tuple[Assign, int]]:
    for one in statements:
        if isinstance(one, Loop):
            yield from _operations(one.body, depth + 1)
        elif isinstance(one, Branch):
            yield from _operations(one.body, depth)
        elif one.operation not in _GIVEN:
            # What is outside of the loop over substeps belongs to none.
            yield one, max(depth, 0)


def _table(environment: str) -> Iterator[str]:
    model = model_of(environment)
    found = counts(substep_program(model))
    yield f"{environment}: {found.total()} operations in a substep, {model.nv} degrees of freedom"
    order = list(dict.fromkeys([*_STAGES.values(), "the rest"]))
    for stage, depth in sorted(found, key=lambda key: (order.index(key[0]), key[1])):
        number = found[stage, depth]
        yield f"{number:8} {number / found.total():6.1%}  {stage}, {_DEPTHS[depth]}"


def excerpt(program: Program, size: int) -> Program:
    """The first operations of the substep as a program of their own."""
    (loop,) = (one for one in program.statements if isinstance(one, Loop))
    every = [*program.statements, *loop.body]
    constants = {one.target: one for one in every if isinstance(one, Assign) and one.operation == "constant"}
    chosen = [one for one in loop.body if isinstance(one, Assign) and one.operation not in _GIVEN][:size]
    inside = {one.target for one in chosen}
    used = list(dict.fromkeys(int(one) for each in chosen for one in each.arguments))
    outer = [one for one in used if one not in inside and one not in constants]
    inputs = [Assign(one, "input", ("given", place)) for place, one in enumerate(outer)]
    own = [constants[one] for one in used if one in constants]
    ends = [one.target for one in chosen if one.target not in used]
    outputs = {"found": [Output(one, (place,)) for place, one in enumerate(ends)]}
    return Program(statements=[*inputs, *own, *chosen], outputs=outputs)


def _excerpt(environment: str, size: int) -> Iterator[str]:
    program = excerpt(substep_program(model_of(environment)), size)
    yield "The program:"
    for one in program.statements:
        if isinstance(one, Assign) and one.operation != "input":
            shown = [str(x) if one.operation == "constant" else f"v{x}" for x in one.arguments]
            yield f"  v{one.target} = {one.operation} {' '.join(shown)}"
    yield "Its arithmetic in machine code, without loads and stores:"
    yield from _matching(_assembly(cpu_function(program, "move", vector_width())), _ARITHMETIC)
    yield "The same in PTX:"
    yield from _matching(ptx(gpu_kernel(program, "move"), _CARDS), _ARITHMETIC_OF_PTX)


def _matching(code: str, pattern: str) -> Iterator[str]:
    for line in code.splitlines():
        if re.search(pattern, line.strip()):
            yield "  " + " ".join(line.split())


def _assembly(module: str) -> str:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine: Any = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=2
    )
    return machine.emit_assembly(llvm.parse_assembly(module))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m bench.operations", description=__doc__)
    parser.add_argument("environment")
    parser.add_argument("--lines", type=int, default=0, help="show so many operations and their code")
    given = parser.parse_args()
    shown = _excerpt(given.environment, given.lines) if given.lines else _table(given.environment)
    print("\n".join(shown))
