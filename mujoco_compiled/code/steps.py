"""The steps of a function: the program's statements, and the writing of its outputs."""

from collections.abc import Sequence
from dataclasses import dataclass

from mujoco_compiled.program.program import (
    Assign,
    Branch,
    Call,
    Each,
    Loop,
    Program,
    Read,
    Statement,
    Store,
    Together,
)


@dataclass(frozen=True)
class Write:
    """Writes a variable to its places in an output."""

    output: str
    places: Sequence[int]
    variable: int


Step = Statement | Write


def with_outputs(program: Program) -> list[Step]:
    """The program's statements, and its outputs as soon as they are known."""
    waiting: dict[int, list[Write]] = {}
    for name, outputs in program.outputs.items():
        for one in outputs:
            waiting.setdefault(one.variable, []).append(Write(f"to_{name}", one.places, one.variable))
    found = list[Step]()
    for statement in program.statements:
        found.append(statement)
        for variable in results(statement):
            found += waiting.get(variable, ())
    return found


def num_operations(statements: Sequence[Step]) -> int:
    return sum(_size(one) for one in statements)


def results(step: Step) -> list[int]:
    """The variables that are known after it."""
    match step:
        case Assign() | Read():
            return [step.target]
        case Loop() | Each():
            return [variable for variable, _, _ in step.carried]
        case Branch():
            return [variable for variable, _, _ in step.results]
        case Write() | Store() | Together() | Call():
            return []


def uses(step: Step) -> Sequence[int]:
    """The variables that must be known before it."""
    match step:
        case Assign() | Read() | Store() | Call():
            return step.uses
        case Write():
            return [step.variable]
        case Together():
            return [step.condition, *_free(step.body, [], known=[])]
        case Each():
            before = [one for _, one, _ in step.carried]
            inside = [one for _, _, one in step.carried]
            known = [*results(step), step.counter]
            return [*step.count.variables, *before, *_free(step.body, inside, known=known)]
        case Loop():
            before = [one for _, one, _ in step.carried]
            inside = [one for _, _, one in step.carried]
            inside += [] if step.improves is None else [step.improves]
            return before + _free(step.body, inside, known=results(step))
        case Branch():
            otherwise = [one for _, _, one in step.results]
            inside = [one for _, one, _ in step.results]
            return [step.condition, *otherwise, *_free(step.body, inside, known=[])]


def _free(body: Sequence[Statement], after: Sequence[int], known: Sequence[int]) -> list[int]:
    """The outer variables that a body needs, and those of `after` that it does not compute."""
    inside = {*known, *(one for step in body for one in results(step))}
    used = [one for step in body for one in uses(step)] + list(after)
    return [one for one in used if one not in inside]


def _size(step: Step) -> int:
    if isinstance(step, Loop | Branch | Each | Together):
        return num_operations(step.body) + len(results(step))
    return 0 if isinstance(step, Assign) and step.operation == "constant" else 1
