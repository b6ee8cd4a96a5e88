"""Sines and cosines, as LLVM's instructions."""

from collections.abc import Sequence

import numpy as np

from mujoco_compiled.code.lines import Lines
from mujoco_compiled.program.program import Operation


def reduced(lines: Lines, angle: str) -> tuple[str, str, str]:
    """Sine and cosine of the angle less its quadrants, and the number of quadrants in the low bits."""
    number, constant = lines.target.number, lines.target.constant
    # Adding 1.5 · 2^23 rounds to an integer, which is then in the sum's low bits.
    shifted = _fused(lines, angle, constant(2.0 / np.pi), constant(12582912.0))
    quadrant = lines.value(f"bitcast {number} {shifted} to {lines.target.integer}")
    count = lines.value(f"fsub {number} {shifted}, {constant(12582912.0)}")
    left = angle
    for part in (1.5703125, 4.837512969970703125e-4, 7.54978995489188216e-8):
        left = _fused(lines, count, constant(-part), left)
    square = lines.value(f"fmul {number} {left}, {left}")
    sine = _polynomial(lines, square, (-1.9515295891e-4, 8.3321608736e-3, -1.6666654611e-1, 0.0))
    cosine = _polynomial(
        lines, square, (2.443315711809948e-5, -1.388731625493765e-3, 4.166664568298827e-2, -0.5, 1.0)
    )
    return _fused(lines, sine, left, left), cosine, quadrant


def turn(lines: Lines, name: str, operation: Operation, angle: tuple[str, str, str]) -> None:
    """Sine or cosine: of an angle below π/4 and its quadrant, as `reduced` returns it.

    Source: Moshier's Cephes library, sinf.c: the polynomials; Cody and Waite (1980): the quadrant. Right
    to 2 units in the last place below 8,000 rad.
    """
    sine, cosine, quadrant = angle
    target, integer, truth = lines.target, lines.target.integer, lines.target.truth
    one, two = target.splat("i32", "1"), target.splat("i32", "2")
    odd = lines.value(f"trunc {integer} {quadrant} to {truth}")
    if operation == "cos":
        sine, cosine = cosine, sine
        quadrant = lines.value(f"add {integer} {quadrant}, {one}")
    value = lines.name()
    lines.select(value, odd, cosine, sine)
    half = lines.value(f"and {integer} {quadrant}, {two}")
    sign = lines.value(f"shl {integer} {half}, {target.splat('i32', '30')}")
    bits = lines.value(f"bitcast {target.number} {value} to {integer}")
    turned = lines.value(f"xor {integer} {bits}, {sign}")
    lines.line(f"{name} = bitcast {integer} {turned} to {target.number}")


def _polynomial(lines: Lines, x: str, coefficients: Sequence[float]) -> str:
    """The highest power's coefficient first."""
    value = lines.target.constant(coefficients[0])
    for coefficient in coefficients[1:]:
        value = _fused(lines, value, x, lines.target.constant(coefficient))
    return value


def _fused(lines: Lines, a: str, b: str, c: str) -> str:
    """a b + c, rounded once."""
    number = lines.target.number
    return lines.value(
        f"call {number} @llvm.fma.{lines.target.suffix}({number} {a}, {number} {b}, {number} {c})"
    )
