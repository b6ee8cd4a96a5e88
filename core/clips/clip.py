"""A recording of a body's motion as arrays, and its changes in time. NumPy alone.

Quantities are MuJoCo's: positions in metres, angles in radians, quaternions w x y z, the root's linear
velocity in the world's frame and its angular velocity in the root's own.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.clips.quaternions import Array, conjugate, multiply, rotation_vector, slerp

_VELOCITY = ("velocity", "velocities")


@dataclass(frozen=True, eq=False)
class Clip:
    """T frames of a body's motion, `rate` frames per second.

    root_position: [T, 3] m. root_orientation: [T, 4], unit quaternions. joints: the names of the J hinges
    and slides. joint_positions: [T, J] rad or m. root_linear_velocity, root_angular_velocity: [T, 3] m/s,
    rad/s. joint_velocities: [T, J]. The three velocities are all there or all None. A body that is fixed to
    the world has its root at the origin.

    Raises ValueError if the shapes do not fit, or if there is no positive rate.
    """

    name: str
    rate: float
    root_position: Array
    root_orientation: Array
    joints: tuple[str, ...]
    joint_positions: Array
    root_linear_velocity: Array | None = None
    root_angular_velocity: Array | None = None
    joint_velocities: Array | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise ValueError(f"The clip {self.name!r} has {self.rate:g} frames per second.")
        num_frames, num_joints = len(self.root_position), len(self.joints)
        widths = {name: 3 for name in ("root_position", "root_linear_velocity", "root_angular_velocity")}
        widths |= {"root_orientation": 4, "joint_positions": num_joints, "joint_velocities": num_joints}
        for name, width in widths.items():
            values: Array | None = getattr(self, name)
            if values is not None and values.shape != (num_frames, width):
                shape = list(values.shape)
                raise ValueError(
                    f"`{name}` of the clip {self.name!r} has the shape {shape}, not [{num_frames}, {width}]."
                )
        velocities = (self.root_linear_velocity, self.root_angular_velocity, self.joint_velocities)
        if len({values is None for values in velocities}) > 1:
            raise ValueError(f"The clip {self.name!r} has some of its velocities and lacks others.")

    @property
    def num_frames(self) -> int:
        return len(self.root_position)

    @property
    def duration_s(self) -> float:
        """From the first frame to the last one."""
        return max(self.num_frames - 1, 0) / self.rate

    @property
    def has_velocities(self) -> bool:
        return self.joint_velocities is not None


def arrays(clip: Clip) -> dict[str, Array]:
    """Its arrays by the names of their fields, those that it has; each has a row for each frame."""
    values = {field.name: getattr(clip, field.name) for field in fields(clip)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def cut(clip: Clip, from_s: float = 0.0, to_s: float | None = None) -> Clip:
    """The frames nearest to these moments, and all between. Raises ValueError if fewer than two are left."""
    first = round(from_s * clip.rate)
    last = clip.num_frames - 1 if to_s is None else min(round(to_s * clip.rate), clip.num_frames - 1)
    if last <= first:
        end = "its end" if to_s is None else f"{to_s:g} s"
        raise ValueError(
            f"From {from_s:g} s to {end} the clip {clip.name!r} has fewer than two frames: it lasts "
            f"{clip.duration_s:g} s at {clip.rate:g} frames per second."
        )
    return _with(clip, {name: values[first : last + 1] for name, values in arrays(clip).items()})


def sped_up(clip: Clip, factor: float) -> Clip:
    """The same frames, `factor` times as fast."""
    faster = {name: values * factor for name, values in arrays(clip).items() if name.endswith(_VELOCITY)}
    return replace(_with(clip, faster), rate=clip.rate * factor)


def resampled(clip: Clip, rate: float) -> Clip:
    """The clip at another number of frames per second, from its first moment to at most its last one.

    The root turns at constant speed between two frames (slerp); all else is interpolated linearly.
    """
    if rate == clip.rate:
        return clip
    # A frame that falls on the last one is not lost to rounding.
    num_frames = int(clip.duration_s * rate * (1 + 1e-9) + 1e-9) + 1
    at = np.minimum(np.arange(num_frames) * (clip.rate / rate), clip.num_frames - 1)
    before = np.minimum(at.astype(int), max(clip.num_frames - 2, 0))
    after = np.minimum(before + 1, clip.num_frames - 1)
    share = (at - before)[:, None]
    values = {
        name: (1 - share) * value[before] + share * value[after] for name, value in arrays(clip).items()
    }
    turns = clip.root_orientation
    values["root_orientation"] = slerp(turns[before], turns[after], share)
    return replace(_with(clip, values), rate=rate)


def with_velocities(clip: Clip) -> Clip:
    """The clip with velocities: its own, or central differences of its positions, one-sided at both ends.

    Raises ValueError if there are fewer than two frames.
    """
    if clip.has_velocities:
        return clip
    if clip.num_frames < 2:
        raise ValueError(f"The clip {clip.name!r} has {clip.num_frames} frames: velocities need two.")
    before, after = _neighbours(clip.num_frames)
    seconds = (after - before)[:, None] / clip.rate
    turns = clip.root_orientation
    turned = multiply(conjugate(turns[before]), turns[after])
    return replace(
        clip,
        root_linear_velocity=(clip.root_position[after] - clip.root_position[before]) / seconds,
        root_angular_velocity=rotation_vector(turned) / seconds,
        joint_velocities=(clip.joint_positions[after] - clip.joint_positions[before]) / seconds,
    )


def without_velocities(clip: Clip) -> Clip:
    return replace(clip, root_linear_velocity=None, root_angular_velocity=None, joint_velocities=None)


def _with(clip: Clip, values: dict[str, Array]) -> Clip:
    changes: dict[str, Any] = dict(values)
    return replace(clip, **changes)


def _neighbours(num_frames: int) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    frames = np.arange(num_frames)
    return np.maximum(frames - 1, 0), np.minimum(frames + 1, num_frames - 1)
