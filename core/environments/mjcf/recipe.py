"""A first job for a user's own robot: the options under which it learns to walk by command.

Feet, pose and servos are read from the model.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

import mujoco
import numpy as np

from core.environments.mjcf import holding
from core.environments.mjcf.edit_options import HOME, ModelEdits, Pose
from core.environments.mjcf.edits import edit, without_drawings
from core.environments.task_model import compiled
from core.environments.terms.actuation import position_servos
from core.environments.terms.describe import height_of, inventory, near_world, root_of, touchable
from core.environments.terms.inventory import Inventory
from core.environments.terms.locomotion import Posture
from core.environments.terms.term import Term
from core.environments.terms.walking import OBSERVATION, walking_reward
from core.errors import JobFailed

# s. Larger ones make contacts soft; smaller ones cost time.
_TIMESTEP_S = 0.005
# Shares of a robot's height: of feet above the lowest one, and of a foot's geoms above its own lowest.
_STANDS, _SOLE = 0.06, 0.02
_MOST_FEET = 8
# A front leg differs so much from a hind leg, and an arm from a leg more.
_ALIKE = 0.2
_GRAVITY = 9.81
# The cosine between an axis and another that it follows.
_ALONG = 0.7
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
# Times the frequency of a pendulum as long as the legs: a Go1 of 0.28 m steps at 2 Hz, a G1 of 0.76 m at
# 1.4 Hz.
_STEPS_PER_SWING = 2.3
_SWING, _LEAST_SWING_M, _MOST_SWING_M = 0.25, 0.04, 0.1
# In units of m g h per rad: a joint that carries half of a robot bends by a tenth of a rad or two.
_STIFFNESS = 1.0


@dataclass(frozen=True)
class Recipe:
    """options: those of the environment `mjcf`, without the model. notes: sentences on what was guessed."""

    options: dict[str, Any]
    notes: Sequence[str] = ()


class NoRecipe(Exception):
    """The model is no robot that this can make walk. The sentence says why."""


def recipe(spec: mujoco.MjSpec, pose: Pose | None = None) -> Recipe:
    """The options for the model, which stays as it is. pose: in place of the model's keyframe.

    Raises NoRecipe, and JobFailed if it does not compile.
    """
    whole = compiled(spec.copy())
    before = inventory(whole)
    if not before.has_free_joint:
        raise NoRecipe("its root has no free joint, so it cannot walk away")
    joints = [joint.name for joint in before.moving_joints()]
    if not joints:
        raise NoRecipe("it has no hinge or slide")
    base: dict[str, Any] = {"floor": True}
    if pose is not None:
        base["pose"] = pose.model_dump(exclude_defaults=True)
    elif (keyframe := _keyframe(before)) is not None:
        base["pose"] = {"keyframe": keyframe}
    spec = without_drawings(spec, whole)
    standing = spec.copy()
    edit(standing, ModelEdits.model_validate({"pose": {}, **base}))
    model = compiled(standing)
    feet, floating = _feet(model)
    if not 2 <= len(feet) <= _MOST_FEET:
        raise NoRecipe(f"{len(feet)} of its bodies stand on the floor: name its `feet`")
    servos, notes = _servos(model, before, joints, feet)
    if "pose" not in base:
        notes = [*notes, "It has no keyframe: `edits.pose.joints` says how it stands, with bent knees."]
    if floating:
        named = ", ".join(floating)
        notes = [
            *notes,
            f"In its pose {named} are not on the floor: say in `edits.pose.joints` how it stands.",
        ]
    sole = [geom for foot in feet for geom in foot.geoms]
    edits: dict[str, Any] = {
        **base,
        "feet": [foot.body for foot in feet],
        "collide": sole,
        **({"servos": servos} if servos else {}),
        "pose": base.get("pose", {}),
    }
    if any(model.geom(name).type[0] == _MESH for name in sole):
        edits["primitives"] = [{"geoms": sole, "shape": "box"}]
    options = {"edits": edits, **_task(model, feet)}
    if (timestep := _timestep(spec, edits)) is not None:
        options["timestep"] = timestep
    return Recipe(options, notes)


def _keyframe(model: Inventory) -> str | None:
    named = [name for name in model.keyframes if name]
    return HOME if HOME in named else next(iter(named), None)


# ---- feet ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Standing:
    """body: its name. place: [2] of its lowest point in the root's frame, m. geoms: those of its sole."""

    body: str
    place: np.ndarray
    geoms: Sequence[str]


def _feet(model: mujoco.MjModel) -> tuple[list[_Standing], list[str]]:
    """The limbs' ends on which the robot stands, in the order of a trot: one after the other around the root;
    and those of like limbs that hang in the air in the keyframe `home`, which are feet, too."""
    data, contacts = near_world(model, model.key(HOME).qpos)
    root = root_of(model)
    moving, _ = touchable(model)
    lowest: dict[int, float] = {}
    for contact in contacts:
        for geom in {int(one) for one in contact.geom} & set(moving):
            lowest[geom] = min(lowest.get(geom, np.inf), float(contact.dist))
    ends = _ends(model, root)
    by_end: dict[int, list[int]] = {}
    for geom in lowest:
        if (end := int(model.body_weldid[model.geom_bodyid[geom]])) in ends:
            by_end.setdefault(end, []).append(geom)
    if not by_end:
        return [], []
    height = max(float(data.xpos[root, 2]), 1e-3)
    heights = {end: min(lowest[geom] for geom in geoms) for end, geoms in by_end.items()}
    standing = {end for end, own in heights.items() if own <= min(heights.values()) + _STANDS * height}
    legs = [_limb(model, end, root) for end in standing]
    floating = [
        end
        for end in by_end
        if end not in standing and any(_are_alike(_limb(model, end, root), leg) for leg in legs)
    ]
    feet = list[_Standing]()
    for end in [*standing, *floating]:
        shapes = [geom for geom in by_end[end] if model.geom_type[geom] != _MESH] or by_end[end]
        if floating:  # The pose does not show which geom is a foot: it is the farthest from the joint.
            distances = {geom: np.linalg.norm(data.geom_xpos[geom] - data.xpos[end]) for geom in shapes}
            sole = [max(shapes, key=lambda geom: distances[geom])]
        else:
            sole = [geom for geom in by_end[end] if lowest[geom] <= heights[end] + _SOLE * height]
            sole = [geom for geom in sole if geom in shapes] or sole
        body = int(model.geom_bodyid[min(sole, key=lambda geom: lowest[geom])])
        place = np.mean(data.geom_xpos[sole], axis=0)[:2] - data.xpos[root, :2]
        # A limb in the air may point anywhere; where it begins tells front from hind.
        if floating:
            place = data.xpos[_first_of(model, end, root), :2] - data.xpos[root, :2]
        feet.append(_Standing(model.body(body).name, place, [model.geom(geom).name for geom in sorted(sole)]))
    heading = data.xmat[root].reshape(3, 3)[:2, 0]
    feet.sort(key=lambda foot: _angle(foot.place, heading))
    return feet, [model.body(end).name for end in floating]


def _limb(model: mujoco.MjModel, body: int, root: int) -> tuple[float, float, float]:
    """The limb that ends with the body: its joints, its length in m along its bodies, its mass in kg."""
    num_joints, length, first = 0.0, 0.0, _first_of(model, body, root)
    while body != first:
        num_joints += float(model.body_jntnum[body])
        length += float(np.linalg.norm(model.body_pos[body]))
        body = int(model.body_parentid[body])
    return num_joints + float(model.body_jntnum[first]), length, float(model.body_subtreemass[first])


def _are_alike(one: Sequence[float], other: Sequence[float]) -> bool:
    return all(abs(a - b) <= _ALIKE * max(a, b) for a, b in zip(one, other, strict=True))


def _first_of(model: mujoco.MjModel, body: int, root: int) -> int:
    """The limb's first body."""
    while int(model.body_parentid[body]) not in (0, root):
        body = int(model.body_parentid[body])
    return body


def _angle(place: np.ndarray, heading: np.ndarray) -> float:
    """From the heading to the left, in [0, 2π)."""
    angle = np.arctan2(place[1], place[0]) - np.arctan2(heading[1], heading[0])
    return float(angle % (2 * pi))


def _ends(model: mujoco.MjModel, root: int) -> set[int]:
    """The robot's bodies with joints below which there are no more joints."""
    weld = model.body_weldid
    own = {
        int(weld[body])
        for body in range(1, model.nbody)
        if model.body_rootid[body] == model.body_rootid[root]
    }
    carriers = {int(weld[model.body_parentid[body]]) for body in own}
    return own - carriers - {0, root}


# ---- servos --------------------------------------------------------------------------------------


def _servos(
    model: mujoco.MjModel, before: Inventory, joints: Sequence[str], feet: Sequence[_Standing]
) -> tuple[list[dict[str, Any]], list[str]]:
    """Servos for the joints that have none, and sentences on guesses."""
    servos_there = model.actuator_trnid[position_servos(model), 0]
    held = {model.joint(joint).name for joint in servos_there}
    wanted = [joint for joint in before.moving_joints() if joint.name in joints and joint.name not in held]
    strong = [joint.name for joint in wanted if joint.effort is not None]
    weak = [joint.name for joint in wanted if joint.effort is None]
    servos: list[dict[str, Any]] = []
    if strong:
        servos.append({"joints": [".*"] if len(strong) == len(joints) else strong})
    if not weak:
        return servos, []
    kp = _rounded(_STIFFNESS * before.mass_kg * _GRAVITY * _height(model) / max(1, len(feet) - 1) * 2)
    legs = _legs(model, feet)
    gains: dict[float, list[str]] = {}
    for name in weak:
        joint = model.joint(name)
        stiffness = kp
        if int(joint.id) not in legs:  # It carries itself alone: an undamped 2.5 Hz.
            inertia = float(model.dof_M0[int(joint.dofadr[0])])
            stiffness = _rounded(max(0.1, (2 * pi * 2.5) ** 2 * inertia))
        gains.setdefault(stiffness, []).append(name)
    servos += [
        {"joints": names, "kp": stiffness, "effort": _rounded(0.5 * stiffness)}
        for stiffness, names in gains.items()
    ]
    return servos, [
        f"The model knows no greatest torque of {len(weak)} joints: `kp` and `effort` of their servos follow "
        "from its mass. Write those of its motors there."
    ]


def _legs(model: mujoco.MjModel, feet: Sequence[_Standing]) -> set[int]:
    """The joints between the root and the feet."""
    found, root = set[int](), root_of(model)
    for foot in feet:
        body = int(model.body(foot.body).id)
        while body not in (0, root):
            first = int(model.body_jntadr[body])
            found.update(range(first, first + int(model.body_jntnum[body])))
            body = int(model.body_parentid[body])
    return found


def _rounded(value: float) -> float:
    """To two digits."""
    return float(f"{value:.2g}")


def _timestep(spec: mujoco.MjSpec, edits: dict[str, Any]) -> float | None:
    """5 ms where the servos hold the pose with that; None: the model's own."""
    if spec.option.timestep >= _TIMESTEP_S:
        return None
    changes, changed = ModelEdits.model_validate(edits), spec.copy()
    try:
        edit(changed, changes)
        model = compiled(changed, _TIMESTEP_S)
    except JobFailed:
        return None
    return None if any(holding.problems(model, changes, "")) else _TIMESTEP_S


# ---- the task ------------------------------------------------------------------------------------


def _height(model: mujoco.MjModel) -> float:
    """Of the root in the pose, m."""
    return height_of(model, model.key(HOME).qpos, root_of(model))


def _as_json(term: Term) -> dict[str, Any]:
    """Its kind and what it says beside the defaults."""
    return {"kind": term.label, **term.model_dump(mode="json", exclude_defaults=True, exclude={"kind"})}


def _posture(model: mujoco.MjModel, feet: Sequence[_Standing]) -> Posture:
    """All joints of a quadruped; of what walks on two legs, not those that swing them forward."""
    if len(feet) > 2:
        return Posture(weight=0.1)
    data, legs = mujoco.MjData(model), sorted(_legs(model, feet))
    data.qpos[:] = model.key(HOME).qpos
    mujoco.mj_kinematics(model, data)
    sideways = data.xmat[root_of(model)].reshape(3, 3)[:, 1]
    weights = {
        model.joint(joint).name: 0.0 if abs(float(data.xaxis[joint] @ sideways)) > _ALONG else 0.5
        for joint in legs
    }
    return Posture(weight=0.15, weights={**weights, ".*": 1.0})


def _task(model: mujoco.MjModel, feet: Sequence[_Standing]) -> dict[str, Any]:
    height = _height(model)
    frequency = _STEPS_PER_SWING * sqrt(_GRAVITY / height) / (2 * pi)
    swing = min(max(_SWING * height, _LEAST_SWING_M), _MOST_SWING_M)
    return {
        "feet": [foot.body for foot in feet],
        "gait": {"frequency": round(frequency, 1), "offsets": [0.5 * (n % 2) for n in range(len(feet))]},
        "action": {"kind": "joint_position"},
        "command": {"kind": "velocity"},
        "observation": [_as_json(term) for term in OBSERVATION],
        "reward": [_as_json(term) for term in walking_reward(round(swing, 2), _posture(model, feet))],
        "termination": [
            {"kind": "upright", "least": 0.5},
            {"kind": "height_range", "range": [round(0.45 * height, 3), round(3 * height, 3)]},
        ],
        "reset": {"position_noise": 0.02, "velocity_noise": 0.2},
    }
