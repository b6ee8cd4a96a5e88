"""Loops and branches that environments take side by side, each for itself."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mujoco_compiled.program.arithmetic import Number, Vector, select
from mujoco_compiled.program.program import Assign, Branch, Loop, Program, Statement, Symbol


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
    return program


def _kept(statements: Sequence[Statement], wanted: set[int]) -> list[Statement]:
    """The statements that compute what is wanted. wanted: grows by what they need themselves."""
    found = list[Statement]()
    for one in reversed(statements):
        if isinstance(one, Assign):
            # Inputs stay, for the order of the code's arrays.
            if one.target in wanted or one.operation in ("input", "lane_input"):
                found.append(one)
                wanted.update(one.uses)
        elif isinstance(one, Branch):
            if any(variable in wanted for variable, _, _ in one.results):
                found.append(_kept_branch(one, wanted))
        elif any(variable in wanted for variable, _, _ in one.carried):
            found.append(_kept_loop(one, wanted))
    return found[::-1]


def _kept_branch(branch: Branch, wanted: set[int]) -> Branch:
    results = tuple(entry for entry in branch.results if entry[0] in wanted)
    inside = {one for _, one, _ in results}
    body = _kept(branch.body, inside)
    wanted.update(inside, (otherwise for _, _, otherwise in results), (branch.condition,))
    return replace(branch, results=results, body=tuple(body))


def _kept_loop(loop: Loop, wanted: set[int]) -> Loop:
    carried, inside, body = (), set[int](), list[Statement]()
    while True:
        # A variable that is needed inside is carried, too.
        now = tuple(entry for entry in loop.carried if entry[0] in wanted or entry[0] in inside)
        if now == carried:
            break
        carried = now
        inside = {after for _, _, after in carried}
        if loop.improves is not None:
            inside.add(loop.improves)
        body = _kept(loop.body, inside)
    wanted.update(inside)
    wanted.update(before for _, before, _ in carried)
    return replace(loop, carried=carried, body=tuple(body))
