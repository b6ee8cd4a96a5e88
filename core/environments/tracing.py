"""From a JAX function to an `Expression`: each primitive of its jaxpr as operations on cells."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Jaxpr, Literal

from core.environments.expression import OPERATIONS, Cells, Expression, NotExpressed, Operation, Output

# More operations on single numbers than a page does between two actions.
_MOST_CELLS = 500_000


@dataclass(frozen=True)
class _Traced:
    """An array of cells. Other values are known: arrays of JAX or NumPy."""

    cells: Cells


@dataclass(frozen=True)
class _Missing:
    """A value that depends on what cannot be expressed."""

    why: str


_Value = Any  # _Traced, _Missing, or an array that is known


def expressed(
    function: Callable[[Mapping[str, Any]], Mapping[str, Any]],
    inputs: Mapping[str, jax.ShapeDtypeStruct],
) -> Expression:
    """The function of arrays by name, which gives arrays by name, in operations on numbers.

    An output that no operations express is among its `missing`.
    """
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(dict(inputs))
    tape = _Tape()
    names = sorted(inputs)  # JAX's order.
    given = [_Traced(tape.new(prod(inputs[name].shape)).reshape(inputs[name].shape)) for name in names]
    num_inputs = tape.num_cells
    # What is known is computed beside a training that holds the accelerator.
    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        results = dict(zip(sorted(shapes), tape.run(closed.jaxpr, closed.consts, given), strict=True))
        found = {name: tape.cells(one) for name, one in results.items() if not isinstance(one, _Missing)}

    def number(cells: Cells) -> Cells:
        """While it is traced, the constants' cells are −1, −2, …"""
        num_constants = len(tape.constants)
        return np.where(
            cells < 0, num_inputs - 1 - cells, np.where(cells < num_inputs, cells, cells + num_constants)
        )

    return Expression(
        {name: np.arange(prod(inputs[name].shape)) for name in names},
        np.array([*tape.constants], float),
        [
            Operation(one.name, number(one.results), tuple(map(number, one.arguments)))
            for one in tape.operations
        ],
        {name: Output(number(cells.ravel()), cells.shape) for name, cells in found.items()},
        {name: one.why for name, one in results.items() if isinstance(one, _Missing)},
    )


class _Tape:
    """What has been traced so far. constants: each number's cell."""

    def __init__(self) -> None:
        self.constants: dict[float, int] = {}
        self.operations: list[Operation] = []
        self.num_cells = 0

    def new(self, number: int) -> Cells:
        if self.num_cells + number > _MOST_CELLS:
            raise NotExpressed(f"it takes more than {_MOST_CELLS:,} operations on numbers")
        self.num_cells += number
        return np.arange(self.num_cells - number, self.num_cells)

    def cells(self, value: _Value) -> Cells:
        """Those of a value that is not missing, in its shape."""
        if isinstance(value, _Traced):
            return value.cells
        array = np.asarray(value)
        places = [self.constants.setdefault(one, -1 - len(self.constants)) for one in array.ravel().tolist()]
        return np.array(places, np.int64).reshape(array.shape)

    def add(self, name: str, *arguments: _Value) -> _Traced:
        """The operation on arrays of one shape, or numbers."""
        cells = np.broadcast_arrays(*map(self.cells, arguments))
        results = self.new(cells[0].size)
        self.operations.append(Operation(name, results, tuple(one.ravel() for one in cells)))
        return _Traced(results.reshape(cells[0].shape))

    def reduce(self, name: str, argument: _Value, axes: Sequence[int]) -> _Traced:
        cells = np.moveaxis(self.cells(argument), axes, range(-len(axes), 0))
        kept = cells.shape[: cells.ndim - len(axes)]
        results = self.new(prod(kept))
        self.operations.append(Operation(name, results, (cells.ravel(),)))
        return _Traced(results.reshape(kept))

    def run(self, jaxpr: Jaxpr, constants: Sequence[Any], arguments: Sequence[_Value]) -> list[_Value]:
        """The outputs of a jaxpr."""
        values: dict[Any, _Value] = dict(zip(jaxpr.constvars, constants, strict=True))
        values |= dict(zip(jaxpr.invars, arguments, strict=True))
        for equation in _live(jaxpr):
            read = [one.val if isinstance(one, Literal) else values[one] for one in equation.invars]
            values |= dict(zip(equation.outvars, self._applied(equation, read), strict=True))
        return [one.val if isinstance(one, Literal) else values[one] for one in jaxpr.outvars]

    def _applied(self, equation: Any, read: Sequence[_Value]) -> Sequence[_Value]:
        """The results of one equation."""
        name, parameters = equation.primitive.name, equation.params
        if missing := next((one for one in read if isinstance(one, _Missing)), None):
            return [missing] * len(equation.outvars)
        if name in _CALLS:
            inner = next(parameters[key] for key in _BODIES if key in parameters)
            return self.run(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), read)
        if name == "cond":
            return self._branched(parameters["branches"], read[0], read[1:])
        if not any(isinstance(one, _Traced) for one in read):
            results = equation.primitive.bind(*read, **parameters)
            return results if equation.primitive.multiple_results else [results]
        if name in _MOVES:
            return [_Traced(_MOVES[name](*map(self.cells, read), **parameters))]
        if name in _MOVED_BY_JAX and (moved := self._moved(equation, read)) is not None:
            return moved
        if name in _RULES:
            kinds = [getattr(one.aval.dtype, "kind", "V") for one in (*equation.invars, equation.outvars[0])]
            if (result := _RULES[name](self, kinds, *read, **parameters)) is not None:
                return [result]
        return [_Missing(f"it needs the operation {name}")] * len(equation.outvars)

    def _branched(self, branches: Sequence[Any], which: _Value, read: Sequence[_Value]) -> list[_Value]:
        """The results of the branch with this number; of every branch, if it is not known."""
        if not isinstance(which, _Traced):
            branches, which = [branches[int(which)]], 0
        results = [self.run(branch.jaxpr, branch.consts, read) for branch in branches]
        return [
            next((case for case in cases if isinstance(case, _Missing)), None)
            or _selected(self, [], which, *cases)
            for cases in zip(*results, strict=True)
        ]

    def _moved(self, equation: Any, read: Sequence[_Value]) -> list[_Value] | None:
        """The results of a primitive that moves numbers to places: it is applied to their cells.

        None where the places are not known, or where some are outside.
        """
        chosen = _MOVED_BY_JAX[equation.primitive.name]
        arguments = list(read)
        for place in range(len(read))[chosen]:
            arguments[place] = jnp.asarray(self.cells(read[place]), jnp.float32)
        if unknown := [place for place, one in enumerate(arguments) if isinstance(one, _Traced)]:
            return self._tried(equation, read, unknown[0])
        results = equation.primitive.bind(*arguments, **equation.params)
        listed = results if equation.primitive.multiple_results else [results]
        if not all(np.isfinite(one).all() for one in listed):
            return None
        return [_Traced(np.asarray(one, np.int64)) for one in listed]

    def _tried(self, equation: Any, read: Sequence[_Value], place: int) -> list[_Value] | None:
        """The results, if the argument `place` has starts along one axis of the first argument: of each
        start that there may be, the one that is there."""
        cells, axis = self.cells(read[place]), _axis_of_start(equation, place)
        if not prod(shape := equation.outvars[0].aval.shape):
            return [np.zeros(shape)]  # As what is seen of the next gaps where none is seen.
        if axis is None:
            return None
        there = cells.reshape(()) if cells.size == 1 else None
        if equation.primitive.name == "gather":  # Each start is that of a part of the result.
            there = np.expand_dims(cells[..., 0], equation.params["dimension_numbers"].offset_dims)
        if there is None:
            return None
        result: _Value = None
        for start in range(equation.invars[0].aval.shape[axis]):
            known = np.full(cells.shape, start, np.int32)
            moved = self._moved(equation, [*read[:place], known, *read[place + 1 :]])
            if moved is None:
                return None
            is_there = self.add("ge", _Traced(there), start)
            result = moved[0] if result is None else self.add("select", is_there, result, moved[0])
        return [result]


def _live(jaxpr: Jaxpr) -> list[Any]:
    """The equations on which an output depends."""
    needed = {one for one in jaxpr.outvars if not isinstance(one, Literal)}
    live: list[Any] = []
    for equation in reversed(jaxpr.eqns):
        if needed.intersection(equation.outvars):
            needed.update(one for one in equation.invars if not isinstance(one, Literal))
            live.append(equation)
    return live[::-1]


_CALLS = {
    "checkpoint",
    "closed_call",
    "core_call",
    "custom_jvp_call",
    "custom_vjp_call",
    "jit",
    "pjit",
    "remat",
    "remat2",
}
_BODIES = ("jaxpr", "call_jaxpr", "fun_jaxpr")


def _broadcast(cells: Cells, shape: Sequence[int], broadcast_dimensions: Sequence[int], **_: Any) -> Cells:
    sizes = [1] * len(shape)
    for size, axis in zip(cells.shape, broadcast_dimensions, strict=True):
        sizes[axis] = size
    return np.broadcast_to(cells.reshape(sizes), shape)


def _sliced(
    cells: Cells,
    start_indices: Sequence[int],
    limit_indices: Sequence[int],
    strides: Sequence[int] | None,
) -> Cells:
    bounds = zip(start_indices, limit_indices, strides or [1] * cells.ndim, strict=True)
    return cells[tuple(slice(*one) for one in bounds)]


# Primitives that move all of their numbers.
_MOVES: Mapping[str, Callable[..., Cells]] = {
    "broadcast_in_dim": _broadcast,
    "concatenate": lambda *cells, dimension: np.concatenate(cells, dimension),
    "copy": lambda cells: cells,
    "expand_dims": lambda cells, dimensions: np.expand_dims(cells, dimensions),
    "reshape": lambda cells, new_sizes, **_: cells.reshape(new_sizes),
    "rev": lambda cells, dimensions: np.flip(cells, dimensions),
    "slice": _sliced,
    "stack": lambda *cells, axis: np.stack(cells, axis),
    "squeeze": lambda cells, dimensions: np.squeeze(cells, tuple(dimensions)),
    "tile": lambda cells, reps: np.tile(cells, reps),
    "transpose": lambda cells, permutation: np.transpose(cells, permutation),
}
# Those that move some of their arguments to places that others say.
_MOVED_BY_JAX: Mapping[str, slice] = {
    "dynamic_slice": slice(0, 1),
    "dynamic_update_slice": slice(0, 2),
    "gather": slice(0, 1),
    "pad": slice(0, 2),
    "scatter": slice(0, 3, 2),
    "split": slice(0, 1),
}


def _axis_of_start(equation: Any, place: int) -> int | None:
    """The axis of the first argument along which the argument `place` is a start; None: along several."""
    axes: Sequence[int] = ()
    match equation.primitive.name:
        case "dynamic_slice" | "dynamic_update_slice" as name:
            return place - (1 if name == "dynamic_slice" else 2)
        case "gather":
            axes = equation.params["dimension_numbers"].start_index_map
        case "scatter":
            axes = equation.params["dimension_numbers"].scatter_dims_to_operand_dims
        case _:
            pass
    return axes[0] if len(axes) == 1 else None


def _same(name: str) -> Callable[..., _Value]:
    return lambda tape, kinds, *read, **_: tape.add(name, *read)


def _of_truth(name: str) -> Callable[..., _Value]:
    """An operation on truth; None where the primitive's numbers are bits."""
    return lambda tape, kinds, *read, **_: tape.add(name, *read) if kinds[-1] == "b" else None


def _reduced(name: str, kind: str = "") -> Callable[..., _Value]:
    return lambda tape, kinds, read, axes, **_: (
        tape.reduce(name, read, axes) if not kind or kinds[0] == kind else None
    )


def _divided(tape: _Tape, kinds: Sequence[str], over: _Value, under: _Value, **_: Any) -> _Value:
    result = tape.add("div", over, under)
    return result if kinds[-1] == "f" else tape.add("trunc", result)


def _power(tape: _Tape, _: Sequence[str], read: _Value, y: int) -> _Value:
    return tape.add("mul", read, read) if y == 2 else tape.add("pow", read, y)


def _converted(tape: _Tape, kinds: Sequence[str], read: _Value, **_: Any) -> _Value:
    before, after = kinds
    if after == "b" and before != "b":
        return tape.add("ne", read, 0.0)
    return tape.add("trunc", read) if before == "f" and after in "iu" else read


def _selected(tape: _Tape, _: Sequence[str], which: _Value, *cases: _Value) -> _Value:
    if not isinstance(which, _Traced):
        return _Traced(np.choose(np.asarray(which, int), [tape.cells(case) for case in cases]))
    result = cases[0]
    for number, case in enumerate(cases[1:], 1):
        is_it = which if len(cases) == 2 else tape.add("eq", which, number)
        result = tape.add("select", is_it, result, case)
    return result


def _product(
    tape: _Tape, _: Sequence[str], left: _Value, right: _Value, dimension_numbers: Any, **__: Any
) -> _Value:
    """Σ over the contracted axes, [shared axes, left's others, right's others]."""
    (over_left, over_right), (shared_left, shared_right) = dimension_numbers
    parts: list[Cells] = []
    for value, over, shared in ((left, over_left, shared_left), (right, over_right, shared_right)):
        cells = tape.cells(value)
        own = [axis for axis in range(cells.ndim) if axis not in (*over, *shared)]
        parts.append(np.transpose(cells, (*shared, *own, *over)))
    num_shared, num_over = len(shared_left), len(over_left)
    own = [part.ndim - num_shared - num_over for part in parts]
    first = np.expand_dims(parts[0], tuple(num_shared + own[0] + axis for axis in range(own[1])))
    second = np.expand_dims(parts[1], tuple(num_shared + axis for axis in range(own[0])))
    times = tape.add("mul", _Traced(first), _Traced(second))
    return tape.reduce("reduce_sum", times, range(times.cells.ndim - num_over, times.cells.ndim))


_RULES: Mapping[str, Callable[..., _Value]] = {
    **{name: _same(name) for name in OPERATIONS if name not in ("and", "or", "select", "trunc", "div")},
    "add_any": _same("add"),
    "and": _of_truth("and"),
    "atan": lambda tape, _, read, **__: tape.add("atan2", read, 1.0),
    "clamp": lambda tape, _, low, read, high: tape.add("min", tape.add("max", read, low), high),
    "convert_element_type": _converted,
    "div": _divided,
    "dot_general": _product,
    "integer_pow": _power,
    "logistic": lambda tape, _, read, **__: tape.add(
        "div", 1.0, tape.add("add", 1.0, tape.add("exp", tape.add("neg", read)))
    ),
    "not": lambda tape, kinds, read: tape.add("eq", read, 0.0) if kinds[-1] == "b" else None,
    "or": _of_truth("or"),
    "reduce_and": _reduced("reduce_min", "b"),
    "reduce_max": _reduced("reduce_max"),
    "reduce_min": _reduced("reduce_min"),
    "reduce_or": _reduced("reduce_max", "b"),
    "reduce_prod": _reduced("reduce_prod"),
    "reduce_sum": _reduced("reduce_sum"),
    "rsqrt": lambda tape, _, read, **__: tape.add("div", 1.0, tape.add("sqrt", read)),
    "select_n": _selected,
    "square": lambda tape, _, read: tape.add("mul", read, read),
}
