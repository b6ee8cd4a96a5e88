"""The contents of a compiled model."""

import copy
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

import mujoco
import numpy as np

from core.clips.mirror import mirror_of
from core.clips.skeleton import skeleton_of
from core.environments.terms.actuation import kind_of, motor_of
from core.environments.terms.inventory import Actuator, Inventory, Joint, JointType, Sensor, Sizes
from core.errors import BadClips
from core.physics.model import initial_qpos
from mujoco_compiled import pairs_of_geoms

JOINT_TYPES: dict[Any, JointType] = {
    mujoco.mjtJoint.mjJNT_FREE: "free",
    mujoco.mjtJoint.mjJNT_BALL: "ball",
    mujoco.mjtJoint.mjJNT_SLIDE: "slide",
    mujoco.mjtJoint.mjJNT_HINGE: "hinge",
}

_MOST_PAIRS = 10_000
_TRIED_POSES = 5
# m of the body per rad or m of a joint: less is rounding.
_NO_MOTION = 1e-9
_FAR = 100.0
# Of the cosine of a plane's tilt: less is rounding.
_NO_TILT = 1e-9


def inventory(model: mujoco.MjModel) -> Inventory:
    """The model's parts, by name."""
    root = root_of(model)
    kinds = _joint_types(model, root)
    moving, fixed = touchable(model)
    return Inventory(
        joints=[_joint(model, number) for number in range(model.njnt)],
        actuators=[_actuator(model, number) for number in range(model.nu)],
        sensors=[_sensor(model, number) for number in range(model.nsensor)],
        bodies=_names(model.body, model.nbody),
        geoms=_names(model.geom, model.ngeom),
        cameras=[model.camera(number).name for number in range(model.ncam)],
        keyframes=[model.key(number).name for number in range(model.nkey)],
        sizes=Sizes(**{name: int(getattr(model, name)) for name in Sizes.model_fields}),
        root=model.body(root).name,
        has_free_joint="free" in kinds,
        travels=bool({"free", "slide"} & set(kinds)),
        initial_height=height_of(model, initial_qpos(model), root),
        mass_kg=float(model.body_mass.sum()),
        timestep_s=float(model.opt.timestep),
        num_pairs=_num_pairs(model),
        colliders={name: _welded(model, geom) for geom in moving if (name := model.geom(geom).name)},
        num_fixed_colliders=len(fixed),
        has_level_floor=len(fixed) == 1 and is_level_plane(model, fixed[0]),
        fixed_geoms=[
            name for geom in np.flatnonzero(~moving_geoms(model)).tolist() if (name := model.geom(geom).name)
        ],
        no_mirror=_why_no_mirror(model),
    )


def _why_no_mirror(model: mujoco.MjModel) -> str | None:
    try:
        mirror_of(skeleton_of(model))
    except BadClips as error:
        return error.detail
    return None


def is_level_plane(model: mujoco.MjModel, geom: int) -> bool:
    """Whether the geom is a plane whose normal is vertical."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    is_plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
    return bool(is_plane and data.geom_xmat[geom, 8] > 1.0 - _NO_TILT)


def touchable(model: mujoco.MjModel) -> tuple[list[int], list[int]]:
    """The geoms that can touch something, by their masks or as part of a `<pair>`: those that move, and those
    of the world."""
    can = (model.geom_contype | model.geom_conaffinity) != 0
    can[[*model.pair_geom1, *model.pair_geom2]] = True
    moves = moving_geoms(model)
    return np.flatnonzero(can & moves).tolist(), np.flatnonzero(can & ~moves).tolist()


def moving_geoms(model: mujoco.MjModel) -> np.ndarray:
    """[ngeom]: whether joints move it. Those of the world and of mocap bodies are not moved by any."""
    return model.body_dofnum[model.body_weldid[model.geom_bodyid]] > 0


def _welded(model: mujoco.MjModel, geom: int) -> list[str]:
    """The geom's body and those that this one is welded to, from below."""
    body = int(model.geom_bodyid[geom])
    names = [model.body(body).name]
    while not model.body_jntnum[body] and body:
        body = int(model.body_parentid[body])
        names.append(model.body(body).name)
    return names


def _num_pairs(model: mujoco.MjModel) -> int:
    """The number of pairs of geoms that may touch, counted up to `_MOST_PAIRS`."""
    return sum(1 for _ in islice(pairs_of_geoms(model), _MOST_PAIRS))


def root_of(model: mujoco.MjModel) -> int:
    """The robot's root, sought in the trees that have actuators: the first body with a free joint; else the
    first body that slides and hangs on nothing that moves; else the first body of the first such tree.

    A scene may have a ball, a mocap body or fixed objects before the robot. Without actuators on any tree,
    all of them count.
    """
    driven = _driven_trees(model)
    bodies = [body for body in range(1, model.nbody) if not driven or int(model.body_rootid[body]) in driven]
    for wanted in ("free", "slide"):
        for body in bodies:
            if wanted in _joint_types(model, body) and not model.body_weldid[model.body_parentid[body]]:
                return body
    return bodies[0] if bodies else 0


def _driven_trees(model: mujoco.MjModel) -> set[int]:
    """The first bodies of the trees that actuators act on."""
    moved: list[int] = []
    for kind, target in zip(model.actuator_trntype, model.actuator_trnid[:, 0], strict=True):
        match mujoco.mjtTrn(kind):
            case mujoco.mjtTrn.mjTRN_JOINT | mujoco.mjtTrn.mjTRN_JOINTINPARENT:
                moved.append(model.jnt_bodyid[target])
            case mujoco.mjtTrn.mjTRN_TENDON:
                moved += _bodies_of(model, target)
            case mujoco.mjtTrn.mjTRN_SITE | mujoco.mjtTrn.mjTRN_SLIDERCRANK:
                moved.append(model.site_bodyid[target])
            case mujoco.mjtTrn.mjTRN_BODY:
                moved.append(target)
            case _:
                pass
    return {int(model.body_rootid[body]) for body in moved} - {0}


def _bodies_of(model: mujoco.MjModel, tendon: int) -> Iterator[int]:
    """The bodies along a tendon."""
    first = model.tendon_adr[tendon]
    for wrap in range(first, first + model.tendon_num[tendon]):
        target = model.wrap_objid[wrap]
        match mujoco.mjtWrap(model.wrap_type[wrap]):
            case mujoco.mjtWrap.mjWRAP_JOINT:
                yield model.jnt_bodyid[target]
            case mujoco.mjtWrap.mjWRAP_SITE:
                yield model.site_bodyid[target]
            case mujoco.mjtWrap.mjWRAP_SPHERE | mujoco.mjtWrap.mjWRAP_CYLINDER:
                yield model.geom_bodyid[target]
            case _:
                pass


def can_go_forward(model: mujoco.MjModel, body: int) -> bool:
    """Whether the body can move along the world's x at all: otherwise `forward_velocity` is always 0."""
    data, jacobian = mujoco.MjData(model), np.zeros((3, model.nv))
    random = np.random.default_rng(0)
    for _ in range(_TRIED_POSES):
        data.qpos[:] = initial_qpos(model)
        mujoco.mj_integratePos(model, data.qpos, random.normal(size=model.nv), 1.0)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBody(model, data, jacobian, None, body)
        if np.abs(jacobian[0]).max(initial=0.0) > _NO_MOTION:
            return True
    return False


def height_of(model: mujoco.MjModel, qpos: np.ndarray, body: int) -> float:
    """The body's height in metres, in these positions [nq]."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return float(data.xpos[body, 2])


def _joint_types(model: mujoco.MjModel, body: int) -> list[str]:
    first, number = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    return [JOINT_TYPES[mujoco.mjtJoint(kind)] for kind in model.jnt_type[first : first + number]]


def _names(get: Callable[[int], Any], count: int) -> list[str]:
    return [name for number in range(count) if (name := get(number).name)]


def _joint(model: mujoco.MjModel, number: int) -> Joint:
    joint = model.joint(number)
    kind = JOINT_TYPES[mujoco.mjtJoint(int(joint.type[0]))]
    limited = kind in ("slide", "hinge") and bool(model.jnt_limited[number])
    low, high = map(float, joint.range)
    return Joint(
        name=joint.name,
        type=kind,
        body=model.body(int(joint.bodyid[0])).name,
        qpos_start=int(joint.qposadr[0]),
        qvel_start=int(joint.dofadr[0]),
        range=(low, high) if limited else None,
        effort=_effort(model, number) if kind in ("hinge", "slide") else None,
    )


def _effort(model: mujoco.MjModel, joint: int) -> float | None:
    """The greatest torque or force of the joint's first actuator at the joint; None: there is no limit."""
    limits = list[float]()
    acts_on_it = _acts_on_joints(model) & (model.actuator_trnid[:, 0] == joint)
    for actuator in np.flatnonzero(acts_on_it)[:1]:
        gear = abs(float(model.actuator_gear[actuator, 0]))
        if model.actuator_forcelimited[actuator]:
            limits.append(gear * float(np.abs(model.actuator_forcerange[actuator]).max()))
        is_motor = not model.actuator_gaintype[actuator] and not model.actuator_biastype[actuator]
        if is_motor and model.actuator_ctrllimited[actuator]:
            most = float(np.abs(model.actuator_ctrlrange[actuator]).max())
            limits.append(gear * abs(float(model.actuator_gainprm[actuator, 0])) * most)
    if model.jnt_actfrclimited[joint]:
        limits.append(float(np.abs(model.jnt_actfrcrange[joint]).max()))
    return min(limits, default=None)


def _acts_on_joints(model: mujoco.MjModel) -> np.ndarray:
    """[nu]"""
    kinds = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT
    return np.isin(model.actuator_trntype, [int(kind) for kind in kinds])


def _actuator(model: mujoco.MjModel, number: int) -> Actuator:
    low, high = map(float, model.actuator_ctrlrange[number])
    is_on_joint = _acts_on_joints(model)[number]
    joint = model.joint(model.actuator_trnid[number, 0]).name if is_on_joint else None
    motor = motor_of(model, joint) if joint else None
    return Actuator(
        name=model.actuator(number).name,
        control_range=(low, high) if model.actuator_ctrllimited[number] else None,
        joint=joint,
        kind=kind_of(model, number),
        velocity_limit=motor[0] if motor is not None else None,
    )


def _sensor(model: mujoco.MjModel, number: int) -> Sensor:
    kind = mujoco.mjtSensor(int(model.sensor_type[number])).name.removeprefix("mjSENS_").lower()
    return Sensor(name=model.sensor(number).name, type=kind, size=int(model.sensor_dim[number]))


def near_world(model: mujoco.MjModel, qpos: np.ndarray) -> tuple[mujoco.MjData, list[Any]]:
    """The model in these positions [nq], and the contacts that it has with the world at whatever distance."""
    near, data = copy.copy(model), mujoco.MjData(model)
    for margins in (near.geom_margin, near.body_margin, near.pair_margin):
        margins[:] = _FAR
    data.qpos[:] = qpos
    mujoco.mj_kinematics(near, data)
    mujoco.mj_comPos(near, data)
    mujoco.mj_collision(near, data)
    moves = moving_geoms(model)
    return data, [contact for contact in data.contact if not moves[list(contact.geom)].all()]
