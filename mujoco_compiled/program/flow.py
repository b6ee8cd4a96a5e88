"""Loops and branches that environments take side by side, each for itself."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from mujoco_compiled.program.arithmetic import Number, Vector, select
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
    Symbol,
    Together,
)

_Repeated = TypeVar("_Repeated", Loop, Each)


def repeat(
    most: int, body: Callable[[list[Number]], tuple[list[Number], Number]], carried: list[Number]
) -> list[Number]:
    """The numbers after at most `most` repetitions of `body`.

    `body` also returns whether to repeat it, by environment; True: in any case. An environment that stops
    keeps the numbers that it has.
    """
    symbol = next((number for number in carried if isinstance(number, Symbol)), None)
    if symbol is not None:
        return symbol.program.loop(most, body, carried)
    running = np.True_
    for _ in range(most):
        if not np.any(running):
            break
        after, improves = body(carried)
        carried = [select(running, new, old) for new, old in zip(after, carried, strict=True)]
        running = running & improves
    return carried


def where_needed(
    condition: Number, body: Callable[[], Vector], otherwise: Callable[[Vector], Vector]
) -> Vector:
    """The body's numbers where the condition is true. It costs nothing while it is true nowhere.

    otherwise: from the body's numbers, of which it may use constants alone, to those elsewhere.
    """
    if isinstance(condition, Symbol):
        return condition.program.branch(condition, body, otherwise)
    if isinstance(condition, bool | np.bool_):
        return body() if condition else otherwise(body())
    values = body()
    return [select(condition, one, other) for one, other in zip(values, otherwise(values), strict=True)]


def nothing(values: Vector) -> Vector:
    """A 0 for each of them."""
    return [0.0] * len(values)


def needed(program: Program) -> Program:
    """The program (changed): what its outputs need."""
    wanted = {output.variable for outputs in program.outputs.values() for output in outputs}
    program.statements = _kept(program.statements, wanted)
    program.routines = {name: tuple(_kept(body, set())) for name, body in program.routines.items()}
    return program


def _kept(statements: Sequence[Statement], wanted: set[int]) -> list[Statement]:
    """The statements that compute what is wanted, and all that store or call. wanted: grows by what they
    need."""
    found = list[Statement]()
    for one in reversed(statements):
        if not _is_needed(one, wanted):
            continue
        match one:
            case Assign() | Read() | Store() | Call():
                wanted.update(one.uses)
            case Together():
                one = replace(one, body=tuple(_kept(one.body, wanted)))
                wanted.add(one.condition)
            case Branch():
                one = _kept_branch(one, wanted)
            case Loop():
                one = _kept_loop(one, wanted)
            case Each():
                one = _kept_loop(one, wanted)
                wanted.update(one.count.variables)
        found.append(one)
    return found[::-1]


def _is_needed(one: Statement, wanted: set[int]) -> bool:
    """Whether it computes what is wanted, or stores. Inputs stay, for the order of the code's arrays."""
    match one:
        case Assign():
            return one.target in wanted or one.operation in ("input", "lane_input")
        case Read():
            return one.target in wanted
        case Branch():
            return any(variable in wanted for variable, _, _ in one.results)
        case Loop():
            return any(variable in wanted for variable, _, _ in one.carried)
        case Store() | Each() | Together() | Call():
            return True


def _kept_branch(branch: Branch, wanted: set[int]) -> Branch:
    results = tuple(entry for entry in branch.results if entry[0] in wanted)
    inside = {one for _, one, _ in results}
    body = _kept(branch.body, inside)
    wanted.update(inside, (otherwise for _, _, otherwise in results), (branch.condition,))
    return replace(branch, results=results, body=tuple(body))


def _kept_loop(loop: _Repeated, wanted: set[int]) -> _Repeated:
    carried, inside, body = list[tuple[int, int, int]](), set[int](), list[Statement]()
    is_known = False
    while True:
        # A variable that is needed inside is carried, too.
        now = [entry for entry in loop.carried if entry[0] in wanted or entry[0] in inside]
        if is_known and now == carried:
            break
        carried, is_known = now, True
        inside = {after for _, _, after in carried}
        if isinstance(loop, Loop) and loop.improves is not None:
            inside.add(loop.improves)
        body = _kept(loop.body, inside)
    wanted.update(inside)
    wanted.update(before for _, before, _ in carried)
    return replace(loop, carried=tuple(carried), body=tuple(body))
