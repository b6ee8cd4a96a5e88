"""Changes of a specification before it is compiled, as `edit_options` describes them."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from core.environments.mjcf.edit_options import (
    HOME,
    Collide,
    Fit,
    ModelEdits,
    Pose,
    Servo,
    free_name,
    gains,
)
from core.environments.mjcf.model import name_parts
from core.environments.task_model import compiled
from core.environments.terms.actuation import add_motor, position_servos
from core.environments.terms.describe import near_world
from core.errors import JobFailed
from core.patterns import Patterns, matches, matching
from core.physics.model import initial_qpos
from core.reasons import Reason
from core.rendering import floor, scene
from mujoco_compiled import uncovered

_DRIVEN = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
_ON_A_JOINT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
_ACTUATOR_SENSORS = (
    mujoco.mjtSensor.mjSENS_ACTUATORPOS,
    mujoco.mjtSensor.mjSENS_ACTUATORVEL,
    mujoco.mjtSensor.mjSENS_ACTUATORFRC,
)
_SHAPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}
_INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}
# Viewers draw the groups 0 to 2, and hide what is there for contacts alone.
_GROUP_OF_CONTACTS = 3
_SLIDING = 0
_WITH_FRICTION = 3


def edit(spec: mujoco.MjSpec, edits: ModelEdits) -> None:
    """Change the specification. What a pattern names that is not there is left out: see `edit_check`.

    Raises JobFailed("bad_model") if a servo's kp cannot be known, the pose's keyframe is not there, or the
    model does not compile where that is needed.
    """
    name_parts(spec)
    if edits.floor:
        add_floor(spec)
    fit_primitives(spec, edits.primitives)
    collide(spec, edits.collide, edits.feet or [])
    if edits.friction is not None:
        set_friction(spec, edits.friction)
    add_servos(spec, edits.servos)
    if edits.integrator or edits.servos:
        spec.option.integrator = _INTEGRATORS[edits.integrator or "implicitfast"]
    if edits.pose is not None:
        add_pose(spec, edits.pose)


def edits_for_compiled(spec: mujoco.MjSpec) -> ModelEdits | None:
    """The change of what collides with which the engine `compiled` runs the model; None if it does not help.

    The specification stays as it is. Raises JobFailed("bad_model") if it does not compile.
    """
    edits = ModelEdits(floor=True, collide="floor")
    edit(changed := spec.copy(), edits)
    return edits if uncovered(compiled(changed)) is None else None


def without_drawings(spec: mujoco.MjSpec, model: mujoco.MjModel) -> mujoco.MjSpec:
    """A copy with the masses of the compiled model and without what touches nothing, to be compiled quickly:
    meshes that are only drawn take seconds."""
    lean = spec.copy()
    name_parts(lean)
    keep_inertias(lean, model)
    paired = {name for pair in lean.pairs for name in (pair.geomname1, pair.geomname2)}
    for geom in list(lean.geoms):
        if not (_can_touch(geom) or geom.name in paired):
            lean.delete(geom)
    kept = {geom.meshname for geom in lean.geoms}
    for mesh in [mesh for mesh in lean.meshes if mesh.name not in kept]:
        lean.delete(mesh)
    for skin in list(lean.skins):
        lean.delete(skin)
    return lean


# ---- what can touch ------------------------------------------------------------------------------


def add_floor(spec: mujoco.MjSpec) -> None:
    """Add a plane at height 0, with tiles of 0.5 m, if nothing of the world can be touched."""
    if any(_can_touch(geom) for geom in spec.geoms if _is_fixed(geom.parent)):
        return
    look = _stage(spec)
    spec.worldbody.add_geom(
        name=free_name("floor", [geom.name for geom in spec.geoms]),
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        material=look.name,
    )


def _stage(spec: mujoco.MjSpec) -> Any:
    """The material of a floor's tiles. Adds a sky and a light where there are none."""
    texture = mujoco.mjtTexture
    if all(one.type != texture.mjTEXTURE_SKYBOX for one in spec.textures):
        high, low = scene.SKY_COLOURS
        gradient = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
        spec.add_texture(
            name=free_name("sky", [one.name for one in spec.textures]),
            type=texture.mjTEXTURE_SKYBOX,
            builtin=gradient,
            rgb1=high,
            rgb2=low,
            width=64,
            height=384,
        )
    if not list(spec.lights):
        spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[0, 0, 4], dir=[0, 0, -1])
    tiles = spec.add_texture(
        name=free_name("floor", [one.name for one in spec.textures]),
        type=texture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=floor.DARK,
        rgb2=floor.LIGHT,
        width=64,
        height=64,
    )
    name = free_name("floor", [one.name for one in spec.materials])
    look = spec.add_material(name=name, texrepeat=[2, 2], texuniform=True, specular=0.1)
    look.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = tiles.name
    return look


def collide(spec: mujoco.MjSpec, wanted: Collide, feet: Patterns) -> None:
    """Let the moving geoms that are wanted touch all of the world that can be touched, and nothing else touch
    anything. A `<pair>` of such a geom with one of the world stays, with its parameters; other pairs go.

    feet: patterns of the feet's bodies. Geoms of bodies that are welded to a foot are the foot's.
    """
    if wanted == "declared":
        return
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    of_feet = set(matching(feet, (body.name for body in spec.bodies)))
    fixed, chosen = set[str](), set[str]()
    for geom in spec.geoms:
        touches = _can_touch(geom) or geom.name in paired
        if _is_fixed(geom.parent):
            fixed.add(geom.name)
            geom.contype, geom.conaffinity = int(_can_touch(geom)), 0
            continue
        if wanted == "feet":
            is_chosen = touches and _is_part_of(geom.parent, of_feet)
        elif wanted == "floor":
            is_chosen = touches
        else:
            is_chosen = bool(matching(wanted, [geom.name]))
        if is_chosen:
            chosen.add(geom.name)
        # What touches by pairs alone goes on so.
        has_mask = _can_touch(geom) or geom.name not in paired
        geom.contype, geom.conaffinity = 0, int(is_chosen and has_mask)
    for pair in list(spec.pairs):
        both = {pair.geomname1, pair.geomname2}
        if not (both & fixed and both & chosen):
            spec.delete(pair)


def set_friction(spec: mujoco.MjSpec, friction: float) -> None:
    """Give moving geoms that can touch something this sliding friction, before that of what they touch."""
    for geom in spec.geoms:
        if _can_touch(geom) and not _is_fixed(geom.parent):
            geom.friction[_SLIDING] = friction
            geom.condim = max(geom.condim, _WITH_FRICTION)
            geom.priority = max(geom.priority, 1)


def fit_primitives(spec: mujoco.MjSpec, fits: Sequence[Fit]) -> None:
    """Replace colliding meshes by shapes fitted to their bounding boxes. A mesh that is also drawn stays as a
    geom that only is drawn, and bodies keep their masses and inertias."""
    meshes = [
        (geom, fit.shape)
        for geom in spec.geoms
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH and _can_touch(geom)
        for fit in fits
        if any(matches(pattern, geom.name) for pattern in fit.geoms)
    ]
    if not meshes:
        return
    keep_inertias(spec, compiled(spec))
    spec.compiler.fitaabb = True
    replaced = set[str]()
    for geom, shape in meshes:
        if geom.name in replaced:
            continue
        replaced.add(geom.name)
        if geom.group < _GROUP_OF_CONTACTS:
            _add_drawing(geom)
        geom.type, geom.group = _SHAPES[shape], _GROUP_OF_CONTACTS


def _add_drawing(geom: Any) -> None:
    """A geom beside this mesh that is drawn like it, and neither touches nor weighs anything."""
    drawn = geom.parent.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=geom.meshname,
        pos=geom.pos,
        quat=geom.quat,
        material=geom.material,
        rgba=geom.rgba,
        group=geom.group,
        contype=0,
        conaffinity=0,
        mass=0,
    )
    drawn.alt = geom.alt


def keep_inertias(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Write the masses and inertias that follow from geoms into their bodies. model: the compiled one."""
    for body in spec.bodies[1:]:
        if body.explicitinertial and spec.compiler.inertiafromgeom != 1:
            continue
        inertial = model.body(body.id)
        body.mass, body.ipos, body.iquat = float(inertial.mass[0]), inertial.ipos, inertial.iquat
        body.inertia, body.explicitinertial = inertial.inertia, True
    spec.compiler.inertiafromgeom = 0


def _is_part_of(body: Any, names: set[str]) -> bool:
    """Whether the body, or one that it is welded to, has such a name."""
    while body.name not in names:
        if body.joints or body.parent is None:
            return False
        body = body.parent
    return True


def _can_touch(geom: Any) -> bool:
    return bool(geom.contype or geom.conaffinity)


def _is_fixed(body: Any) -> bool:
    """Whether the body is the world's or welded to it."""
    while body.parent is not None:
        if body.joints:
            return False
        body = body.parent
    return True


# ---- what drives it ------------------------------------------------------------------------------


def add_servos(spec: mujoco.MjSpec, servos: Sequence[Servo]) -> None:
    """Turn the first actuator of each joint that a servo names into it, add one where there is none, and
    remove the joint's further actuators with their sensors. Keyframes lose their controls."""
    if not servos:
        return
    actuators = defaultdict[str, list[Any]](list)
    for actuator in spec.actuators:
        if actuator.trntype in _ON_A_JOINT:
            actuators[actuator.target].append(actuator)
    taken = {actuator.name for actuator in spec.actuators}
    for joint in spec.joints:
        servo = next((servo for servo in servos if _drives(servo, joint)), None)
        if servo is not None:
            first, *others = actuators[joint.name] or [_added(spec, joint.name, taken)]
            for actuator in others:
                _remove(spec, actuator)
            effort = _become_servo(first, joint, servo)
            _load(joint, servo)
            if servo.velocity_limit is not None and effort is not None:
                add_motor(spec, joint.name, servo.velocity_limit, servo.saturation_effort or effort)
    for key in spec.keys:
        key.ctrl, key.act = [], []


def _drives(servo: Servo, joint: Any) -> bool:
    return joint.type in _DRIVEN and bool(matching(servo.joints, [joint.name]))


def _added(spec: mujoco.MjSpec, joint: str, taken: set[str]) -> Any:
    name = joint if joint not in taken else f"{joint} servo"
    return spec.add_actuator(name=name, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)


def _become_servo(actuator: Any, joint: Any, servo: Servo) -> float | None:
    """Its greatest torque or force; None: it has no limit."""
    effort = servo.effort or effort_of(actuator, joint) or servo.saturation_effort
    try:
        match servo.control:
            case "position":
                kp, kd = gains(servo, effort)
                actuator.set_to_position(kp=kp, kv=kd)
            case "velocity":
                actuator.set_to_velocity(kv=gains(servo, effort)[1] if servo.kd is None else servo.kd)
            case "effort":
                actuator.set_to_motor()
    except ValueError as error:
        raise JobFailed(Reason.BAD_MODEL, f"The joint {joint.name!r}: {error}.") from None
    actuator.trntype, actuator.gear = mujoco.mjtTrn.mjTRN_JOINT, [1, 0, 0, 0, 0, 0]
    actuator.ctrllimited, actuator.ctrlrange, actuator.inheritrange = False, [0, 0], 0
    actuator.actlimited, actuator.actrange = False, [0, 0]
    actuator.forcelimited = effort is not None
    actuator.forcerange = [-effort, effort] if effort is not None else [0, 0]
    return effort


def _load(joint: Any, servo: Servo) -> None:
    """Give the joint what the motor brings."""
    if servo.armature is not None:
        joint.armature = servo.armature
    if servo.friction_loss is not None:
        joint.frictionloss = servo.friction_loss
    if servo.damping is not None:
        joint.damping = [servo.damping, 0, 0]


def effort_of(actuator: Any, joint: Any) -> float | None:
    """The greatest torque of the actuator at its joint before it becomes a servo, N m; None: no limit."""
    gear, limits = abs(float(actuator.gear[0])), list[float]()
    if force := _bound(actuator.forcelimited, actuator.forcerange):
        limits.append(gear * force)
    is_motor = actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED and (
        actuator.biastype == mujoco.mjtBias.mjBIAS_NONE
    )
    if is_motor and (control := _bound(actuator.ctrllimited, actuator.ctrlrange)):
        limits.append(gear * abs(float(actuator.gainprm[0])) * control)
    if torque := _bound(joint.actfrclimited, joint.actfrcrange):
        limits.append(torque)
    return min(limits, default=None)


def _bound(limited: int, values: Sequence[float]) -> float | None:
    """The larger end of a range that holds; by itself it does where it is not empty."""
    low, high = map(float, values)
    holds = limited != mujoco.mjtLimited.mjLIMITED_FALSE and high > low
    return max(abs(low), abs(high)) if holds else None


def _remove(spec: mujoco.MjSpec, actuator: Any) -> None:
    for sensor in list(spec.sensors):
        if sensor.type in _ACTUATOR_SENSORS and sensor.objname == actuator.name:
            spec.delete(sensor)
    spec.delete(actuator)


# ---- where it stands -----------------------------------------------------------------------------


def add_pose(spec: mujoco.MjSpec, pose: Pose) -> None:
    """Make the pose the keyframe `home`, in place of one of that name. Its controls hold it by servos."""
    qpos = posed(model := compiled(spec), pose)
    for key in [key for key in spec.keys if key.name == HOME]:
        spec.delete(key)
    servos, targets = np.flatnonzero(position_servos(model)), np.zeros(model.nu)
    targets[servos] = qpos[model.jnt_qposadr[model.actuator_trnid[servos, 0]]]
    spec.add_key(name=HOME, qpos=qpos, ctrl=targets)


def posed(model: mujoco.MjModel, pose: Pose) -> np.ndarray:
    """Positions [nq] in this pose. Raises JobFailed("bad_model") if its keyframe is not there."""
    if pose.keyframe is None:
        qpos = initial_qpos(model)
    elif pose.keyframe in (model.key(number).name for number in range(model.nkey)):
        qpos = model.key(pose.keyframe).qpos.copy()
    else:
        raise JobFailed(Reason.BAD_MODEL, f"The model has no keyframe {pose.keyframe!r}.")
    for number in range(model.njnt):
        joint = model.joint(number)
        value = next((value for name, value in pose.joints.items() if matches(name, joint.name)), None)
        if value is not None and mujoco.mjtJoint(int(model.jnt_type[number])) in _DRIVEN:
            qpos[model.jnt_qposadr[number]] = value
    free = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
    if free.size:
        height = int(model.jnt_qposadr[free[0]]) + 2
        if pose.height is None:
            qpos[height] -= clearance(model, qpos) or 0.0
        else:
            qpos[height] = pose.height
    return qpos


def clearance(model: mujoco.MjModel, qpos: np.ndarray) -> float | None:
    """The least distance in m of moving geoms from what they can touch of the world, below 0 where they are
    in it; None if they can touch nothing of it."""
    _, contacts = near_world(model, qpos)
    return min((float(contact.dist) for contact in contacts), default=None)
