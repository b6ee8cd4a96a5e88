"""The rows of the constraint problem: joints at their limits, and points that touch a plane.

Every row that the model can ever have is there at all times; where it is not active, its stiffness D is 0.
So the program's shape does not depend on the state.
Source: MuJoCo's documentation, Computation, "Constraint model", and Modeling, "Solver parameters".
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from core.physics.compiled.arithmetic import (
    Number,
    Vector,
    absolute,
    add,
    cross,
    dot,
    maximum,
    minimum,
    rotate,
    scale,
    select,
    sqrt,
    subtract,
    total,
)
from core.physics.compiled.dynamics import Motion
from core.physics.compiled.kinematics import Poses
from core.physics.compiled.rows import Direction, Group, Rows
from core.physics.compiled.tree import Tree


@dataclass(frozen=True)
class Softness:
    """How a constraint gives way: MuJoCo's solref and solimp.

    stiffness, damping: of the reference acceleration. impedance: at the surface, in the depth, and the width
    in m or rad between them; its curve has MuJoCo's default midpoint 0.5 and power 2.
    A row at distance r < 0 with speed v wants the acceleration -damping · v - stiffness · d(r) · r.
    """

    stiffness: float
    damping: float
    impedance: tuple[float, float, float]


@dataclass(frozen=True)
class Limit:
    """A hinge's or slide's range in rad or m. inverse_weight: MuJoCo's `dof_invweight0`."""

    qpos: int
    dof: int
    low: float
    high: float
    margin: float
    softness: Softness
    inverse_weight: float


@dataclass(frozen=True)
class Point:
    """A sphere of a body, or an end of its capsule, and a plane that stands still.

    offset: the sphere's centre in the body's frame, in m. along: the capsule's axis in the body's frame; None
    for a sphere. normal: [3]; height: of the plane along its normal, in m. friction: tangential, 0 without
    any. inverse_weight: MuJoCo's `body_invweight0`, of translations.
    """

    body: int
    offset: Vector
    along: Vector | None
    radius: float
    normal: Vector
    height: float
    friction: float
    margin: float
    softness: Softness
    inverse_weight: float


@dataclass(frozen=True)
class State:
    """qpos: [nq]. qvel: [nv]."""

    qpos: Vector
    qvel: Vector


def read_limits(model: mujoco.MjModel) -> tuple[Limit, ...]:
    """The limited hinges and slides."""
    found = list[Limit]()
    for joint in np.flatnonzero(model.jnt_limited):
        dof = int(model.jnt_dofadr[joint])
        found.append(
            Limit(
                qpos=int(model.jnt_qposadr[joint]),
                dof=dof,
                low=float(model.jnt_range[joint, 0]),
                high=float(model.jnt_range[joint, 1]),
                margin=float(model.jnt_margin[joint]),
                softness=_softness(model, model.jnt_solref[joint], model.jnt_solimp[joint]),
                inverse_weight=float(model.dof_invweight0[dof]),
            )
        )
    return tuple(found)


def read_points(model: mujoco.MjModel) -> tuple[Point, ...]:
    """The points of spheres and capsules that can touch a plane, one body's after another's."""
    at_rest = mujoco.MjData(model)
    mujoco.mj_kinematics(model, at_rest)
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    found = list[Point]()
    for plane in planes:
        normal = at_rest.geom_xmat[plane].reshape(3, 3)[:, 2]
        for geom in range(model.ngeom):
            if _touch(model, int(plane), geom):
                found += _points(model, int(plane), geom, normal, float(normal @ at_rest.geom_xpos[plane]))
    return tuple(found)


def constraint_rows(
    tree: Tree, limits: tuple[Limit, ...], points: tuple[Point, ...], at: Poses, moving: Motion, state: State
) -> Rows:
    """All rows in this state, limits first."""
    return [
        *(_of_limit(limit, state) for limit in limits),
        *(_of_point(tree, point, at, moving, state.qvel) for point in points),
    ]


def _of_limit(limit: Limit, state: State) -> Group:
    """The nearer end of the range: both are never active at once."""
    above, below = state.qpos[limit.qpos] - limit.low, limit.high - state.qpos[limit.qpos]
    sign = select(above < below, 1.0, -1.0)
    distance = minimum(above, below) - limit.margin
    return _group([{limit.dof: sign}], [[1.0]], limit.softness, limit.inverse_weight, distance, state.qvel)


def _of_point(tree: Tree, point: Point, at: Poses, moving: Motion, qvel: Vector) -> Group:
    """A frictionless row, or the four edges of a pyramid."""
    body = tree.bodies[point.body]
    centre = add(at.positions[point.body], rotate(at.rotations[point.body], point.offset))
    gap = dot(point.normal, centre) - point.height - point.radius
    touched = subtract(centre, scale(point.normal, point.radius + 0.5 * gap))
    arm = subtract(touched, moving.centres[body.root])
    # How each degree of freedom moves the point, [3].
    speeds = {i: add(moving.axes[i][3:], cross(moving.axes[i][:3], arm)) for i in _moved_by(tree, point.body)}
    normal, distance, weight = point.normal, gap - point.margin, point.inverse_weight
    if not point.friction:
        along = [{i: dot(normal, speed) for i, speed in speeds.items()}]
        return _group(along, [[1.0]], point.softness, weight, distance, qvel)
    axis = rotate(at.rotations[point.body], point.along) if point.along else None
    frame = [normal, *_tangents(normal, axis)]
    directions = [{i: dot(one, speed) for i, speed in speeds.items()} for one in frame]
    friction = point.friction
    edges = [[1.0, friction, 0.0], [1.0, -friction, 0.0], [1.0, 0.0, friction], [1.0, 0.0, -friction]]
    weight *= (1.0 + friction**2) * 2.0 * friction**2
    return _group(directions, edges, point.softness, weight, distance, qvel)


def _group(
    directions: list[Direction],
    mixtures: list[list[float]],
    softness: Softness,
    inverse_weight: float,
    distance: Number,
    qvel: Vector,
) -> Group:
    impedance = _impedance(softness, distance)
    stiffness = _stiffness(impedance, inverse_weight, distance)
    speeds = [total(entry * qvel[i] for i, entry in one.items()) for one in directions]
    references = [_reference(softness, impedance, distance, dot(mixture, speeds)) for mixture in mixtures]
    return Group(directions, mixtures, [stiffness] * len(mixtures), references)


def _moved_by(tree: Tree, body: int) -> list[int]:
    """The degrees of freedom that move the body."""
    while body:
        own = [i for i, dof in enumerate(tree.dofs) if dof.body == body]
        if own:
            return [*tree.dofs[own[-1]].ancestors, own[-1]]
        body = tree.bodies[body].parent
    return []


def _tangents(normal: Vector, along: Vector | None) -> tuple[Vector, Vector]:
    """Two directions at right angles to the normal and to each other, those of `mju_makeFrame`."""
    if along is None:
        along = [0.0, 1.0, 0.0] if abs(normal[1]) < 0.5 else [0.0, 0.0, 1.0]
    across = subtract(along, scale(normal, dot(normal, along)))
    length = sqrt(dot(across, across))
    first = scale(across, 1.0 / maximum(length, 1e-15))
    return first, cross(normal, first)


def _impedance(softness: Softness, distance: Number) -> Number:
    """d(r), between its value at the surface and that in the depth."""
    lowest, highest, width = softness.impedance
    x = minimum(absolute(distance) * (1.0 / width), 1.0)
    rest = 1.0 - x
    curve = select(x < 0.5, 2.0 * x * x, 1.0 - 2.0 * (rest * rest))
    return lowest + curve * (highest - lowest)


def _stiffness(impedance: Number, inverse_weight: float, distance: Number) -> Number:
    """1 / R, with R = (1 - d) / d · A; 0 where the constraint is not active."""
    return select(distance < 0.0, impedance / ((1.0 - impedance) * inverse_weight), 0.0)


def _reference(softness: Softness, impedance: Number, distance: Number, speed: Number) -> Number:
    return -(softness.damping * speed + softness.stiffness * (impedance * distance))


def _touch(model: mujoco.MjModel, plane: int, geom: int) -> bool:
    if model.body_weldid[model.geom_bodyid[geom]] == 0:
        return False
    types, affinities = model.geom_contype, model.geom_conaffinity
    return bool(types[plane] & affinities[geom] or types[geom] & affinities[plane])


def _points(model: mujoco.MjModel, plane: int, geom: int, normal: np.ndarray, height: float) -> list[Point]:
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.geom_quat[geom])
    axis = axes.reshape(3, 3)[:, 2]
    is_capsule = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE
    half = float(model.geom_size[geom, 1])
    pair, body = [plane, geom], int(model.geom_bodyid[geom])
    share = model.geom_solmix[plane] / model.geom_solmix[pair].sum()
    fields = (model.geom_solref, model.geom_solimp)
    mixed = [share * field[plane] + (1.0 - share) * field[geom] for field in fields]
    return [
        Point(
            body=body,
            offset=[float(x) for x in model.geom_pos[geom] + end * axis],
            along=[float(x) for x in axis] if is_capsule else None,
            radius=float(model.geom_size[geom, 0]),
            normal=[float(x) for x in normal],
            height=height,
            friction=float(model.geom_friction[pair, 0].max()) if model.geom_condim[pair].max() > 1 else 0.0,
            margin=float(model.geom_margin[pair].sum() - model.geom_gap[pair].sum()),
            softness=_softness(model, *mixed),
            inverse_weight=float(model.body_invweight0[body, 0]),
        )
        for end in ((half, -half) if is_capsule else (0.0,))
    ]


def _softness(model: mujoco.MjModel, solref: np.ndarray, solimp: np.ndarray) -> Softness:
    """Of a time constant and a damping ratio; the time constant is at least two substeps."""
    time_constant, ratio = max(float(solref[0]), 2.0 * model.opt.timestep), float(solref[1])
    lowest, highest = (float(x) for x in np.clip(solimp[:2], mujoco.mjMINIMP, mujoco.mjMAXIMP))
    stiffness = 1.0 / (highest**2 * time_constant**2 * ratio**2)
    return Softness(stiffness, 2.0 / (highest * time_constant), (lowest, highest, float(solimp[2])))
