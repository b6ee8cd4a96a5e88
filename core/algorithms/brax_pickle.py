"""Reads a pickle of Brax's parameters as data: nothing that the pickle names is imported or called.

Its commands move plain values about; a name stays a name, and a call a name with its arguments. Only then
what is known becomes numbers: NumPy's and JAX's arrays of numbers, and Brax's records as dicts.
"""

import io
import math
import re
from dataclasses import dataclass
from pickletools import genops
from typing import Any

import numpy as np

Name = tuple[str, str]

_STATISTICS = "brax.training.acme.running_statistics"
_MODE: Name = (_STATISTICS, "NormalizationMode")
_RECORDS: set[Name] = {(_STATISTICS, "RunningStatisticsState"), ("brax.training.types", "UInt64")}
_ARRAY: Name = ("numpy._core.multiarray", "_reconstruct")
_SCALAR: Name = ("numpy._core.multiarray", "scalar")
_BUFFER: Name = ("numpy._core.numeric", "_frombuffer")
_JAX_ARRAY: Name = ("jax._src.array", "_reconstruct_array")
_DTYPE: Name = ("numpy", "dtype")
_NUMBERS = re.compile(r"b1|[iu][1248]|f[248]")
_MOST_DIMENSIONS, _LARGEST_SIDE = 8, 2**31
# Names inside names may hold one value many times over: these bound what becomes of it.
_MOST_VALUES, _DEEPEST = 20_000, 20

_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_LITERALS = re.compile(r"(SHORT_|BIN)*(BININT[12]?|LONG[14]|BINFLOAT|BINUNICODE8?|BINBYTES8?)|BYTEARRAY8")
_TUPLES = {"EMPTY_TUPLE": 0, "TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}


@dataclass
class _Call:
    """A call that the pickle asks for, and the state that it gives to what comes of it."""

    name: Name
    arguments: tuple[Any, ...]
    state: Any = None


def read(content: bytes) -> tuple[Any, bytes]:
    """The parameters, and the bytes behind the pickle. A record is a dict; a member of an enumeration its
    value or name. Raises an exception of some kind for a pickle that holds anything else."""
    file = io.BytesIO(content)
    found = _Reader(file).found()
    return _Numbers().of(found, 0), file.read()


class _Reader:
    """Follows the commands of protocols 3 to 5 that Brax's parameters need."""

    def __init__(self, file: io.BytesIO) -> None:
        self._file = file
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}

    def found(self) -> Any:
        for opcode, argument, _ in genops(self._file):
            self._follow(opcode.name, argument)
        (found,) = self._stack
        return found

    def _follow(self, command: str, argument: Any) -> None:  # noqa: C901 # One line for each command.
        push = self._stack.append
        match command:
            case "PROTO" | "FRAME" | "STOP":
                pass
            case "NONE" | "NEWTRUE" | "NEWFALSE":
                push(_CONSTANTS[command])
            case "EMPTY_DICT":
                push({})
            case "MARK":
                self._marks.append(len(self._stack))
            case "TUPLE":
                push(tuple(self._since_mark()))
            case "EMPTY_TUPLE" | "TUPLE1" | "TUPLE2" | "TUPLE3":
                push(tuple(self._last(_TUPLES[command])))
            case "SETITEM" | "SETITEMS":
                items = self._last(2) if command == "SETITEM" else self._since_mark()
                for name, value in zip(items[::2], items[1::2], strict=True):
                    self._stack[-1][_text(name)] = value
            case "MEMOIZE" | "BINPUT" | "LONG_BINPUT":
                self._memo[len(self._memo) if argument is None else argument] = self._stack[-1]
            case "BINGET" | "LONG_BINGET":
                push(self._memo[argument])
            case "GLOBAL":
                push(_Call(_name(*argument.split(" ")), ()))
            case "STACK_GLOBAL":
                push(_Call(_name(*self._last(2)), ()))
            case "REDUCE" | "NEWOBJ":
                made, arguments = self._last(2)
                push(_Call(made.name, _tuple(arguments)))
            case "BUILD":
                (state,) = self._last(1)
                self._stack[-1].state = state
            case _:
                if not _LITERALS.fullmatch(command):
                    raise ValueError(f"{command} does not belong in a policy")
                push(argument)

    def _last(self, number: int) -> list[Any]:
        first = len(self._stack) - number
        if first < (self._marks[-1] if self._marks else 0):
            raise ValueError("there are not so many values")
        last = self._stack[first:]
        del self._stack[first:]
        return last

    def _since_mark(self) -> list[Any]:
        first = self._marks.pop()
        last = self._stack[first:]
        del self._stack[first:]
        return last


class _Numbers:
    """Makes numbers of what a pickle says, up to a bound."""

    def __init__(self) -> None:
        self._left = _MOST_VALUES

    def of(self, value: Any, depth: int) -> Any:
        self._left -= 1
        if self._left < 0 or depth > _DEEPEST:
            raise ValueError("it holds too much for a policy")
        if value is None or type(value) in (bool, int, float, str):
            return value
        if type(value) is tuple:
            return tuple(self.of(item, depth + 1) for item in value)
        if type(value) is dict:
            return {name: self.of(item, depth + 1) for name, item in value.items()}
        if type(value) is not _Call:
            raise ValueError(f"a {type(value).__name__} does not belong in a policy")
        if value.name in _RECORDS and type(value.state) is dict:
            return self.of(value.state, depth + 1)
        return _called(value.name, value.arguments, value.state)


def _called(name: Name, arguments: tuple[Any, ...], state: Any) -> Any:
    if name == _MODE:
        (value,) = arguments
        return value if type(value) is int else _refuse(name)
    if name == ("builtins", "getattr"):  # Python 3.11.0 to 3.11.3 write a member of an enumeration so.
        kind, member = arguments
        return _text(member) if kind.name == _MODE else _refuse(name)
    if name == _JAX_ARRAY:
        made, _, state, _ = arguments
        name = made.name
    if name == _ARRAY:
        _, shape, dtype, in_columns, content = state
        return _array(content, dtype, shape, "F" if in_columns else "C")
    if name == _BUFFER:
        return _array(*arguments)
    if name == _SCALAR:
        dtype, content = arguments
        return _array(content, dtype, (), "C")[()]
    return _refuse(name)


def _array(content: Any, dtype: Any, shape: Any, order: Any) -> Any:
    """An array of numbers whose bytes are as many as its shape says."""
    kind, sides = _numbers(dtype), _tuple(shape)
    if not all(type(side) is int and 0 <= side < _LARGEST_SIDE for side in sides):
        raise ValueError("an array in it has no shape")
    if len(sides) > _MOST_DIMENSIONS or math.prod(sides) * kind.itemsize != len(content):
        raise ValueError(f"an array in it has {len(content)} bytes, and another shape")
    read = np.frombuffer(bytes(content), kind).reshape(sides, order="F" if order == "F" else "C")
    return read.astype(kind.newbyteorder("="), order="K")


def _numbers(dtype: Any) -> "np.dtype[Any]":
    """A type of numbers; `np.dtype` is given its checked name and byte order alone."""
    name = _text(dtype.arguments[0])
    if dtype.name != _DTYPE or not _NUMBERS.fullmatch(name):
        raise ValueError("an array in it does not hold numbers")
    order = dtype.state[1] if dtype.state else "="
    return np.dtype(name).newbyteorder(order if order in ("<", ">") else "=")


def _name(module: Any, name: Any) -> Name:
    return _text(module).replace("numpy.core", "numpy._core"), _text(name)


# Checked before anything else looks at them: to hash or to print a nest of tuples may take for ever.
def _text(value: Any) -> str:
    return value if type(value) is str else _refuse(("a", type(value).__name__))


def _tuple(value: Any) -> tuple[Any, ...]:
    return value if type(value) is tuple else _refuse(("a", type(value).__name__))


def _refuse(name: Name) -> Any:
    raise ValueError(f"{'.'.join(name)} does not belong in a policy")
