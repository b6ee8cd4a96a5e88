"""A substep in double precision, written down as a program once, and run with NumPy.

The stages compute the same with NumPy (see `test_program.py`), but take several times as long: they compute
constants again at each substep, and what they need twice, twice.
"""

from collections.abc import Callable

import numpy as np

from mujoco_compiled.program.arithmetic import Vector
from mujoco_compiled.program.interpret import interpret
from mujoco_compiled.program.program import Program
from mujoco_compiled.substep import Model, SubstepState, substep

FIELDS = ("qpos", "qvel", "act", "qacc")


def recorded(
    model: Model, state: SubstepState, ctrl: Vector
) -> Callable[[SubstepState, Vector], SubstepState]:
    """The program of `substep` for states and controls of as many numbers as these, [environments] each."""
    program, shape = Program(), np.shape(state.qpos[0])
    symbols = {name: program.inputs(name, len(getattr(state, name))) for name in FIELDS}
    moved = substep(model, SubstepState(**symbols), program.inputs("ctrl", len(ctrl)))
    for name in FIELDS:
        program.output(name, getattr(moved, name))

    def step(state: SubstepState, ctrl: Vector) -> SubstepState:
        given = {name: getattr(state, name) for name in FIELDS} | {"ctrl": ctrl}
        found = interpret(program, given)
        return SubstepState(**{name: [np.broadcast_to(x, shape) for x in found[name]] for name in FIELDS})

    return step
