"""Actuators that push at a site, between two sites, or by a crank.

Source: MuJoCo's documentation, Computation, "Actuation model", "Transmission", and XML reference,
"actuator/general", `site`, `refsite` and `cranksite`.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import mujoco

from mujoco_compiled.fields import Fields
from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    add,
    cross,
    dot,
    maximum,
    product,
    quaternion_product,
    rotate,
    rotation_matrix,
    scale,
    select,
    sqrt,
    subtract,
    transpose,
)
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.paths import Posture, Stretch, lever_arms, moved_alone, wrench
from mujoco_compiled.smooth.spatial import conjugate, rotation_vector

_SMALLEST = float(mujoco.mjMINVAL)


@dataclass(frozen=True)
class Site:
    """body: that carries it. position [3] in m and quaternion [4]: in the body's frame."""

    body: int
    position: Vector
    quaternion: Vector

    def place(self, at: Poses) -> Vector:
        """[3] in the world, in m."""
        return add(at.positions[self.body], rotate(at.rotations[self.body], self.position))

    def rotation(self, at: Poses) -> Matrix:
        """To the world."""
        return product(at.rotations[self.body], rotation_matrix(self.quaternion))


@dataclass(frozen=True)
class AtSite:
    """A force and a torque along the axes of a site, or of another that they push against; None: the world.

    gear: [6], of the three forces and the three torques. pulled: see `lever_arms`.
    """

    site: Site
    against: Site | None
    gear: Vector
    pulled: Mapping[int, tuple[int, ...]]

    @property
    def dofs(self) -> Collection[int]:
        """The degrees of freedom on which it acts."""
        return self.pulled


@dataclass(frozen=True)
class ByCrank:
    """A rod of a length in m from a crank's site to a slider, which moves along the z axis of its site."""

    crank: Site
    slider: Site
    rod: float
    gear: Number
    pulled: Mapping[int, tuple[int, ...]]

    @property
    def dofs(self) -> Collection[int]:
        """The degrees of freedom on which it acts."""
        return self.pulled


def read_site_path(fields: Fields, actuator: int) -> AtSite | ByCrank:
    """What an actuator on a site or by a crank acts along."""
    model, gear = fields.model, fields.row("actuator_gear", actuator)
    first, second = (int(x) for x in model.actuator_trnid[actuator])
    site, other = _site(model, first), _site(model, second) if second >= 0 else None
    pulled = moved_alone(model, [site.body, other.body if other else 0])
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_SLIDERCRANK and other:
        rod = float(model.actuator_cranklength[actuator])
        return ByCrank(site, other, rod, gear[0], pulled)
    return AtSite(site, other, gear, pulled)


def site_stretch(path: AtSite, posture: Posture) -> Stretch:
    """The length: how far the site is from the other along the gear's axes; 0 without another."""
    at, against, body = posture.at, path.against, path.site.body
    place = path.site.place(at)
    rotation = (against or path.site).rotation(at)
    force, torque = rotate(rotation, path.gear[:3]), rotate(rotation, path.gear[3:])
    wrenches = [(body, wrench(posture, body, place, force, torque))]
    length: Number = 0.0
    if against is not None:
        origin = against.place(at)
        turn = quaternion_product(conjugate(_quaternion(against, at)), _quaternion(path.site, at))
        apart = rotate(transpose(rotation), subtract(place, origin))
        length = dot(path.gear, [*apart, *rotation_vector(turn)])
        back = [scale(one, -1.0) for one in (force, torque)]
        wrenches.append((against.body, wrench(posture, against.body, origin, *back)))
    return Stretch(length, lever_arms(path.pulled, posture, wrenches))


def crank_stretch(path: ByCrank, posture: Posture) -> Stretch:
    """The length: how far the rod pushes the slider along its axis."""
    at = posture.at
    end, origin = path.crank.place(at), path.slider.place(at)
    axis, way = transpose(path.slider.rotation(at))[2], subtract(end, origin)
    along = dot(way, axis)
    left = along * along + path.rod * path.rod - dot(way, way)
    # Where the rod is too short, the slider is taken to be beside the crank.
    reaches = left > 0.0
    height = sqrt(maximum(left, _SMALLEST))
    length = along - select(reaches, height, 0.0)
    share = 1.0 - select(reaches, along / height, 0.0)
    force = add(scale(axis, share), scale(way, select(reaches, 1.0 / height, 0.0)))
    force, torque = scale(force, path.gear), scale(cross(axis, way), path.gear * share)
    crank, slider = path.crank.body, path.slider.body
    wrenches = [
        (crank, wrench(posture, crank, end, force, [0.0] * 3)),
        (slider, wrench(posture, slider, origin, scale(force, -1.0), torque)),
    ]
    return Stretch(path.gear * length, lever_arms(path.pulled, posture, wrenches))


def _site(model: mujoco.MjModel, number: int) -> Site:
    position, quaternion = model.site_pos[number], model.site_quat[number]
    return Site(int(model.site_bodyid[number]), [float(x) for x in position], [float(x) for x in quaternion])


def _quaternion(site: Site, at: Poses) -> Vector:
    return quaternion_product(at.quaternions[site.body], site.quaternion)
