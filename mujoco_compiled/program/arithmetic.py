"""Numbers that the stages of a substep compute with, and functions of them.

A stage is a plain function of numbers, so that the same lines can compute and be compiled. A number is a
constant of the model (float), a NumPy array with an entry for each environment, or a symbol of a program.
Vectors are lists of numbers, matrices lists of rows.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from mujoco_compiled.program.program import Operation, Symbol, call

# Not a union: every combination of kinds adds and multiplies, which Python's types cannot say.
Number = Any
Vector = list[Number]
Matrix = list[Vector]


def _function(operation: Operation, computed: Callable[..., Number]) -> Callable[..., Number]:
    """Writes the operation down where an argument is a symbol, and otherwise computes it."""

    def function(*arguments: Number) -> Number:
        if any(isinstance(argument, Symbol) for argument in arguments):
            return call(operation, *arguments)
        result = computed(*arguments)
        return float(result) if isinstance(result, np.floating) else result

    return function


sqrt = _function("sqrt", np.sqrt)
sine = _function("sin", np.sin)
cosine = _function("cos", np.cos)
absolute = _function("absolute", np.abs)
truncated = _function("truncate", np.trunc)
minimum = _function("minimum", np.minimum)
maximum = _function("maximum", np.maximum)
_select = _function("select", np.where)


def select(condition: Number, chosen: Number, otherwise: Number) -> Number:
    """A condition on constants is known, and chooses at once."""
    if isinstance(condition, bool | np.bool_):
        return chosen if condition else otherwise
    return _select(condition, chosen, otherwise)


def squared(x: Number) -> Number:
    return x * x


def polynomial(coefficients: Sequence[Number], x: Number) -> Number:
    """By Horner's rule. coefficients: by power, from 0 on."""
    found: Number = 0.0
    for coefficient in reversed(coefficients):
        found = found * x + coefficient
    return found


def clip(x: Number, low: Number, high: Number) -> Number:
    return minimum(maximum(x, low), high)


def total(terms: Iterable[Number]) -> Number:
    """The sum, in pairs of pairs: short chains of additions, and small rounding errors. 0.0 of no terms."""
    left = list(terms)
    if not left:
        return 0.0
    while len(left) > 1:
        pairs = [left[i] + left[i + 1] for i in range(0, len(left) - 1, 2)]
        left = pairs + left[len(left) - len(left) % 2 :]
    return left[0]


def dot(a: Sequence[Number], b: Sequence[Number]) -> Number:
    return total(x * y for x, y in zip(a, b, strict=True))


def add(a: Vector, b: Vector) -> Vector:
    return [x + y for x, y in zip(a, b, strict=True)]


def subtract(a: Vector, b: Vector) -> Vector:
    return [x - y for x, y in zip(a, b, strict=True)]


def scale(a: Vector, factor: Number) -> Vector:
    return [x * factor for x in a]


def cross(a: Vector, b: Vector) -> Vector:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def rotate(rotation: Matrix, vector: Vector) -> Vector:
    """R v."""
    return [dot(row, vector) for row in rotation]


def product(a: Matrix, b: Matrix) -> Matrix:
    """A B."""
    return [[dot(row, column) for column in zip(*b, strict=True)] for row in a]


def transpose(a: Matrix) -> Matrix:
    return [list(column) for column in zip(*a, strict=True)]


def quaternion_product(a: Vector, b: Vector) -> Vector:
    """a b, with the real part first."""
    real = a[0] * b[0] - dot(a[1:], b[1:])
    return [real, *add(add(scale(b[1:], a[0]), scale(a[1:], b[0])), cross(a[1:], b[1:]))]


def normalized(a: Vector) -> Vector:
    return scale(a, 1.0 / sqrt(dot(a, a)))


def rotation_about(axis: Vector, angle: Number) -> Vector:
    """The quaternion of a turn by `angle` in rad about an axis of length 1."""
    return [cosine(0.5 * angle), *scale(axis, sine(0.5 * angle))]


def rotation_matrix(quaternion: Vector) -> Matrix:
    """The rotation matrix of a quaternion of length 1."""
    w, x, y, z = quaternion
    return [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
