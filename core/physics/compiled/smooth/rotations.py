"""The rotation vector of a quaternion: an axis times the angle about it."""

from math import pi

from core.physics.compiled.program.arithmetic import (
    Number,
    Vector,
    absolute,
    cosine,
    dot,
    maximum,
    scale,
    select,
    sine,
    sqrt,
)


def conjugate(quaternion: Vector) -> Vector:
    """The opposite rotation, of a quaternion of length 1."""
    real, *imaginary = quaternion
    return [real, *(-x for x in imaginary)]


def rotation_vector(quaternion: Vector) -> Vector:
    """[3] in rad, at most π long. quaternion: of length 1; it and its negative are the same rotation."""
    real, *imaginary = quaternion
    length = sqrt(dot(imaginary, imaginary))
    angle = 2.0 * _angle(length, absolute(real))
    signed = select(real < 0.0, -angle, angle)
    return scale(imaginary, signed / maximum(length, 1e-30))


def _angle(sine_of: Number, cosine_of: Number) -> Number:
    """The angle between 0 and π / 2 with this sine and cosine.

    Each correction adds the sine of what is missing, e, which leaves e³ / 6: from 0.07 rad to 2e-14.
    """
    angle = (0.5 * pi) * (sine_of / (sine_of + cosine_of))
    for _ in range(2):
        angle = angle + (sine_of * cosine(angle) - cosine_of * sine(angle))
    return angle
