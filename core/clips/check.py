"""What is wrong with a clip, and what may be: by its numbers alone, and by a body that takes its poses."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.clips.clip import Clip, arrays
from core.clips.kinematics import Poses, colliding_geoms, floor_height, lowest, poses, qpos
from core.clips.quaternions import Array, conjugate, multiply, rotation_vector
from core.clips.skeleton import Skeleton, listed

# Frames whose pose is looked at, evenly spread over the clip.
_MOST_POSES = 1000
# Of the body's size (`Skeleton.size`): 1.08 m for a G1, so 6 cm and 2 cm.
_SUNK, _NEARLY_SUNK, _AFLOAT, _FAR_ABOVE = 0.06, 0.015, 0.1, 5.0
_UNITS = {"millimetres": 0.001, "centimetres": 0.01}
# The order that quaternions have, the order in which they were read, and the columns of what was read that
# give w x y z.
_ORDERS = (("x y z w", "w x y z", (3, 0, 1, 2)), ("w x y z", "x y z w", (1, 2, 3, 0)))
# rad or m beyond a joint's limit.
_FAR_BEYOND, _BEYOND = 1.0, 0.05
# A body that moves has an angle beyond this in degrees, and hardly in radians.
_NO_RADIANS = 7.0
# A step between two frames is a jump if it stands out from its neighbours by this factor and is greater than
# so many rad, or so much of the body's size.
_STANDS_OUT, _JUMP, _JUMP_OF_SIZE = 5.0, 0.5, 0.3
# Speeds of a jump that no body has: rad/s, and sizes of the body a second; a sprinter has 6.
_FAST, _FAST_OF_SIZE = 40.0, 15.0
# rad/s that no body has, jump or not: a pitcher's shoulder reaches 130.
_FASTEST = 150.0


@dataclass(frozen=True)
class Findings:
    """problems: each makes the clip unusable. warnings: it can be used. All are sentences."""

    problems: list[str]
    warnings: list[str]


def numeric_problems(clip: Clip) -> list[str]:
    """What makes its numbers unusable, whatever the body: no frames, NaN, quaternions that are none."""
    if clip.num_frames < 2:
        frames = "no frames" if clip.num_frames == 0 else "one frame"
        return [f"The clip has {frames}; motion needs at least two."]
    for name, values in arrays(clip).items():
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            frame, column = bad[0]
            what = f"joint `{clip.joints[column]}`" if name.startswith("joint_") else f"`{name}`"
            value = "NaN" if np.isnan(values[frame, column]) else "infinite"
            number = len(np.unique(bad[:, 0]))
            return [f"In frame {frame} {what} is {value}; such numbers are in {number} of the frames."]
    lengths = np.linalg.norm(clip.root_orientation, axis=-1)
    if np.abs(lengths - 1).max() > 0.01:
        frame = int(np.abs(lengths - 1).argmax())
        return [
            f"In frame {frame} the root's quaternion has the length {lengths[frame]:.3g}, not 1: it is no "
            "rotation, or the columns are in another order."
        ]
    return []


def check(clip: Clip, skeleton: Skeleton) -> Findings:
    """What a body that takes the clip's poses shows. For an aligned clip without `numeric_problems`."""
    problems: list[str] = []
    warnings: list[str] = []
    problems += _degrees(clip, skeleton)
    if not problems:
        far, beyond = _limits(clip, skeleton)
        problems += far
        warnings += beyond
        impossible, strange = _jumps(clip, skeleton)
        problems += impossible
        warnings += strange
    if skeleton.root_joint is None:
        problems += _moves_what_is_fixed(clip, skeleton)
    frames = np.unique(np.linspace(0, clip.num_frames - 1, _MOST_POSES).astype(int))
    if skeleton.root_joint is not None and not problems:
        rows = qpos(clip, skeleton)[frames]
        problems += _order(rows, skeleton) or _units(rows, skeleton)
        if not problems:
            sunk, nearly = _floor(poses(rows, skeleton.model), frames, skeleton)
            problems += sunk
            warnings += nearly
    return Findings(problems, warnings)


def _moves_what_is_fixed(clip: Clip, skeleton: Skeleton) -> list[str]:
    moved = np.abs(clip.root_position - clip.root_position[0]).max()
    if moved <= 0.01 * skeleton.size:
        return []
    return [
        f"The clip moves its root by {moved:.3g} m, but the model's body is fixed to the world: it has no "
        "free joint."
    ]


def _violations(positions: Array, skeleton: Skeleton) -> Array:
    """By how much each joint is beyond its limits, [T, J] rad or m; 0 for a joint without limits."""
    model = skeleton.model
    low, high = np.asarray(model.jnt_range)[skeleton.joint_ids].T
    beyond = np.maximum(np.maximum(low - positions, positions - high), 0)
    return np.where(np.asarray(model.jnt_limited, bool)[skeleton.joint_ids], beyond, 0)


def _hinges(skeleton: Skeleton) -> NDArray[np.bool_]:
    kinds = np.asarray(skeleton.model.jnt_type)[skeleton.joint_ids]
    return kinds == int(mujoco.mjtJoint.mjJNT_HINGE)


def _degrees(clip: Clip, skeleton: Skeleton) -> list[str]:
    beyond = _violations(clip.joint_positions, skeleton) * _hinges(skeleton)
    if not beyond.size or beyond.max() <= _FAR_BEYOND or np.abs(clip.joint_positions).max() < _NO_RADIANS:
        return []
    as_radians = _violations(np.radians(clip.joint_positions), skeleton) * _hinges(skeleton)
    if as_radians.max() > 0.2:
        return []
    frame, joint = np.unravel_index(int(beyond.argmax()), beyond.shape)
    return [
        f"Joint `{clip.joints[joint]}` is at {clip.joint_positions[frame, joint]:.4g} in frame {frame}. "
        "Taken as degrees, all joints are within their limits: give radians."
    ]


def _limits(clip: Clip, skeleton: Skeleton) -> tuple[list[str], list[str]]:
    beyond = _violations(clip.joint_positions, skeleton)
    most = beyond.max(axis=0, initial=0.0)
    far = [
        _beyond(clip, skeleton, beyond, joint) for joint in np.argsort(-most)[:1] if most[joint] > _FAR_BEYOND
    ]
    if far:
        return far, []
    over = [int(joint) for joint in np.argsort(-most) if most[joint] > _BEYOND]
    if not over:
        return [], []
    others = f" So are {listed([clip.joints[joint] for joint in over[1:]])}." if len(over) > 1 else ""
    return [], [_beyond(clip, skeleton, beyond, over[0]) + others]


def _beyond(clip: Clip, skeleton: Skeleton, beyond: Array, joint: int) -> str:
    frame = int(beyond[:, joint].argmax())
    low, high = np.asarray(skeleton.model.jnt_range)[skeleton.joint_ids[joint]]
    unit = "rad" if _hinges(skeleton)[joint] else "m"
    return (
        f"Joint `{clip.joints[joint]}` is at {clip.joint_positions[frame, joint]:.3g} {unit} in frame "
        f"{frame}, beyond its limits [{low:.3g}, {high:.3g}]."
    )


def _jumps(clip: Clip, skeleton: Skeleton) -> tuple[list[str], list[str]]:
    """Steps between two frames that stand out from their neighbours: the greatest of joints and root.

    One at a speed that no body has is a problem, another a warning.
    """
    problems: list[str] = []
    warnings: list[str] = []
    hinges = _hinges(skeleton)
    turns = clip.root_orientation
    moved = np.linalg.norm(np.diff(clip.root_position, axis=0), axis=-1)
    turned = np.linalg.norm(rotation_vector(multiply(conjugate(turns[:-1]), turns[1:])), axis=-1)
    steps = np.column_stack([moved, turned, np.abs(np.diff(clip.joint_positions, axis=0))])
    lengths = np.array([True, False, *~hinges])
    least = np.where(lengths, _JUMP_OF_SIZE * skeleton.size, _JUMP)
    fastest = np.where(lengths, _FAST_OF_SIZE * skeleton.size, _FAST)
    jumps = _stand_out(steps) & (steps > least)
    impossible = (jumps & (steps * clip.rate > fastest)) | (~lengths & (steps * clip.rate > _FASTEST))
    for which, sentences in ((impossible, problems), (jumps & ~impossible, warnings)):
        if which.any():
            frame, column = np.unravel_index(int(np.where(which, steps / least, 0).argmax()), steps.shape)
            step = steps[frame, column]
            what = ("The root", "The root", *(f"Joint `{name}`" for name in clip.joints))[column]
            unit = "m" if lengths[column] else "rad"
            sentences.append(
                f"{what} jumps by {step:.3g} {unit} between the frames {frame} and {frame + 1}, at "
                f"{step * clip.rate:.3g} {unit}/s{_why(step, unit)}."
            )
    return problems, warnings


def _why(step: float, unit: str) -> str:
    if unit == "rad" and abs(step - 2 * np.pi) < _JUMP:
        return ": a whole turn, so the angle should go on where it passes π"
    return ": the clip may be cut there"


def _stand_out(steps: Array) -> NDArray[np.bool_]:
    """Steps that are much greater than those before and after. [T-1, J]"""
    padded = np.pad(steps, ((1, 1), (0, 0)))
    return steps > _STANDS_OUT * np.maximum(padded[:-2], padded[2:])


def _order(rows: Array, skeleton: Skeleton) -> list[str]:
    """Whether the root's quaternions are in another order: the body would stand, but does not."""
    few = _some(rows)
    start = skeleton.root_address + 3
    as_given = _stance(few, skeleton)
    for is_, read, columns in _ORDERS:
        other = few.copy()
        other[:, start : start + 4] = few[:, [start + column for column in columns]]
        as_other = _stance(other, skeleton)
        falls = as_given.tilt > np.radians(50) and as_other.tilt < np.radians(35)
        floats = as_given.height > 0.2 * skeleton.size and as_other.height < 0.05 * skeleton.size
        # A body that lies would, upright at that height, be deep in the floor.
        stands = as_other.height < max(as_given.height, 0.05 * skeleton.size)
        if stands and (falls or floats):
            return [
                f"The root's quaternions look like {is_} where {read} is read: as they are the body leans by "
                f"{np.degrees(as_given.tilt):.0f}° and is {as_given.height:.2g} m off the floor, in the "
                f"other order {np.degrees(as_other.tilt):.0f}° and {as_other.height:.2g} m."
            ]
    return []


def _units(rows: Array, skeleton: Skeleton) -> list[str]:
    """Whether the root's position is in another unit: the body would stand, but is far above the floor."""
    few = _some(rows)
    start = skeleton.root_address
    if _stance(few, skeleton).height < _FAR_ABOVE * skeleton.size:
        return []
    for unit, metres in _UNITS.items():
        other = few.copy()
        other[:, start : start + 3] *= metres
        if _stance(other, skeleton).height < 0.2 * skeleton.size:
            height = np.abs(few[:, start + 2]).mean()
            return [
                f"The root is {height:.3g} m high. Taken as {unit}, the body is on the floor: give metres."
            ]
    return []


def _some(rows: Array) -> Array:
    return rows[np.unique(np.linspace(0, len(rows) - 1, 40).astype(int))]


@dataclass(frozen=True)
class _Stance:
    """tilt: rad between the body's upright axis and the world's, which nine frames of ten stay below.
    height: m, the mean distance of the lowest point from the floor."""

    tilt: float
    height: float


def _stance(rows: Array, skeleton: Skeleton) -> _Stance:
    model = skeleton.model
    found = poses(rows, model)
    rest = poses(_rest(skeleton)[None], model).body_turns[0, skeleton.root_body]
    upright = found.body_turns[:, skeleton.root_body] @ rest[2]
    tilt = np.arccos(np.clip(upright[:, 2], -1, 1))
    height = np.abs(lowest(found, skeleton).min(axis=1) - floor_height(model)).mean()
    return _Stance(float(np.quantile(tilt, 0.9)), float(height))


def _rest(skeleton: Skeleton) -> Array:
    model = skeleton.model
    return np.asarray(model.key_qpos)[0] if model.nkey else np.asarray(model.qpos0)


def _floor(found: Poses, frames: NDArray[np.int_], skeleton: Skeleton) -> tuple[list[str], list[str]]:
    heights = lowest(found, skeleton) - floor_height(skeleton.model)
    frame, geom = np.unravel_index(int(heights.argmin()), heights.shape)
    least = float(heights[frame, geom])
    size, model = skeleton.size, skeleton.model
    body = str(model.body(int(model.geom_bodyid[colliding_geoms(skeleton)[geom]])).name)
    if least < -_NEARLY_SUNK * size:
        sentence = f"In frame {frames[frame]} `{body}` is {-least * 100:.2g} cm under the floor."
        share = float((heights.min(axis=1) < -_NEARLY_SUNK * size).mean())
        often = f" So is the body in {share:.0%} of the frames." if share > 0.05 else ""
        if least < -_SUNK * size:
            return [f"{sentence}{often} Raise the root, or see whether the body has the clip's size."], []
        return [], [sentence + often]
    if least > _AFLOAT * size:
        return [], [f"The body never comes nearer to the floor than {least * 100:.3g} cm."]
    return [], []
