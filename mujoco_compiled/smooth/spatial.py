"""Spatial vectors about a tree's centre of mass: a rotation's three numbers, then a translation's.

An inertia is ten numbers, as MuJoCo's `cinert`: xx, yy, zz, xy, xz, yz about the tree's centre of mass in
kg m², the mass times the offset from it [3] in kg m, and the mass in kg.
Source: Featherstone (2008), chapter 2; MuJoCo's `engine_util_spatial`.
"""

from math import pi

from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    absolute,
    add,
    cosine,
    cross,
    dot,
    maximum,
    product,
    scale,
    select,
    sine,
    sqrt,
    transpose,
)


def conjugate(quaternion: Vector) -> Vector:
    """The opposite rotation, of a quaternion of length 1."""
    real, *imaginary = quaternion
    return [real, *(-x for x in imaginary)]


def rotation_vector(quaternion: Vector) -> Vector:
    """[3] in rad, at most π long. quaternion: of length 1; it and its negative are the same rotation."""
    real, *imaginary = quaternion
    length = sqrt(dot(imaginary, imaginary))
    angle = 2.0 * angle_of(length, absolute(real))
    signed = select(real < 0.0, -angle, angle)
    return scale(imaginary, signed / maximum(length, 1e-30))


def angle_of(sine_of: Number, cosine_of: Number) -> Number:
    """The angle between 0 and π / 2 in rad with this sine and cosine.

    Each correction adds the sine of what is missing, e, which leaves e³ / 6: from 0.07 rad to 2e-14.
    """
    angle = (0.5 * pi) * (sine_of / (sine_of + cosine_of))
    for _ in range(2):
        angle = angle + (sine_of * cosine(angle) - cosine_of * sine(angle))
    return angle


def about_centre(inertia: Vector, rotation: Matrix, offset: Vector, mass: Number) -> Vector:
    """A body's inertia about a point, in the world's axes. offset: [3], from that point to the centre."""
    xx, yy, zz, xy, xz, yz = inertia
    own = product(product(rotation, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), transpose(rotation))
    x, y, z = offset
    return [
        own[0][0] + mass * (y * y + z * z),
        own[1][1] + mass * (x * x + z * z),
        own[2][2] + mass * (x * x + y * y),
        own[0][1] - mass * (x * y),
        own[0][2] - mass * (x * z),
        own[1][2] - mass * (y * z),
        mass * x,
        mass * y,
        mass * z,
        mass,
    ]


def momentum(inertia: Vector, motion: Vector) -> Vector:
    """I v: the spatial force of an inertia [10] and a motion [6]."""
    xx, yy, zz, xy, xz, yz, *moment, mass = inertia
    turn, way = motion[:3], motion[3:]
    about = [dot([xx, xy, xz], turn), dot([xy, yy, yz], turn), dot([xz, yz, zz], turn)]
    return [*add(about, cross(moment, way)), *add([mass * x for x in way], cross(turn, moment))]


def cross_motion(velocity: Vector, motion: Vector) -> Vector:
    """v × m: how a motion [6] that moves along with a velocity [6] changes."""
    turn, way = velocity[:3], velocity[3:]
    return [*cross(turn, motion[:3]), *add(cross(way, motion[:3]), cross(turn, motion[3:]))]


def cross_force(velocity: Vector, force: Vector) -> Vector:
    """v ×* f: how a force [6] that moves along with a velocity [6] changes."""
    turn, way = velocity[:3], velocity[3:]
    return [*add(cross(turn, force[:3]), cross(way, force[3:])), *cross(turn, force[3:])]
