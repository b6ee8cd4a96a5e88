"""Turns the states of control steps into positions for each frame of a video in real time."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class EpisodeMotion:
    """One episode: time [T] in seconds, strictly rising, positions [T, nq], a target [T, 2 or 3] if any, and
    fields of the model that it has for itself.

    velocities: [T, 2, 3], what the tracked body is told and what it does, each forward and left in m/s and
    turn in rad/s, in its own frame; None if it is told no velocity. reference: the positions [T, nq] of
    the clip that it follows, if any.
    """

    time: Floats
    qpos: Floats
    target: Floats | None = None
    model: Mapping[str, NDArray[np.floating[Any]]] = field(default_factory=dict[str, Any])
    velocities: Floats | None = None
    reference: Floats | None = None

    @property
    def duration_s(self) -> float:
        return float(self.time[-1] - self.time[0])


@dataclass(frozen=True)
class Shot:
    """The frames of one episode: positions [N, nq], a target [N, 2 or 3] if any, its own fields of the model,
    velocities [N, 2, 3] if any, a reference [N, nq] if any; see `EpisodeMotion`. The picture cuts between two
    shots."""

    qpos: Floats
    target: Floats | None = None
    model: Mapping[str, NDArray[np.floating[Any]]] = field(default_factory=dict[str, Any])
    velocities: Floats | None = None
    reference: Floats | None = None


def shots(
    model: mujoco.MjModel, motions: Sequence[EpisodeMotion], *, fps: int, seconds: float
) -> Iterator[Shot]:
    """The episodes one after another, sampled `fps` times a second, cut off after `seconds`.

    Frame i shows the moment i / fps, so the video plays in real time. There is at least one frame.
    Within an episode positions are interpolated; across a boundary they are not.
    """
    starts = np.cumsum([0.0, *(motion.duration_s for motion in motions)])
    num_frames = max(1, int(np.floor(min(seconds, starts[-1]) * fps + 1e-6)))
    moments = np.arange(num_frames) / fps
    # Which episode each moment falls into; a moment on a boundary belongs to the later one.
    owner = np.clip(np.searchsorted(starts, moments + 1e-9, side="right") - 1, 0, len(motions) - 1)
    for index, motion in enumerate(motions):
        own = moments[owner == index] - starts[index] + motion.time[0]
        if own.size:
            held = np.searchsorted(motion.time, own + 1e-9, side="right") - 1
            target, velocities = (
                None if values is None else values[held] for values in (motion.target, motion.velocities)
            )
            reference = None
            if motion.reference is not None:
                reference = interpolate(model, replace(motion, qpos=motion.reference), own)
            yield Shot(interpolate(model, motion, own), target, motion.model, velocities, reference)


def calmed(time: Floats, values: Floats, *, spread_s: float) -> Floats:
    """The values [T, ...] averaged over what came before, with weights that fall by e in `spread_s` s."""
    means = values.copy()
    for row in range(1, len(values)):
        share = -np.expm1(-(time[row] - time[row - 1]) / spread_s)
        means[row] = means[row - 1] + share * (values[row] - means[row - 1])
    return means


def interpolate(model: mujoco.MjModel, motion: EpisodeMotion, moments: Floats) -> Floats:
    """Positions [N, nq] at `moments` [N] in seconds, held at the ends; rotations along the shortest arc."""
    later = np.clip(np.searchsorted(motion.time, moments, side="right"), 1, max(1, len(motion.time) - 1))
    if len(motion.time) == 1:
        return np.repeat(motion.qpos, len(moments), axis=0)
    earlier = later - 1
    span = motion.time[later] - motion.time[earlier]
    share = np.clip((moments - motion.time[earlier]) / span, 0.0, 1.0)
    positions = motion.qpos[earlier].copy()
    velocity = np.zeros(model.nv)
    for row, (start, end, part) in enumerate(zip(earlier, later, share, strict=True)):
        mujoco.mj_differentiatePos(model, velocity, 1.0, motion.qpos[start], motion.qpos[end])
        mujoco.mj_integratePos(model, positions[row], velocity, float(part))
    return positions


def smoothed(path: Floats, *, fps: int, spread_s: float) -> Floats:
    """The path [N, 3] under a Gaussian window of `spread_s` s standard deviation, without lag.

    The path is extended at both ends by point reflection, so that a steady walk stays steady.
    """
    spread = spread_s * fps
    reach = min(int(3 * spread), len(path) - 1)
    if reach < 1:
        return path
    window = np.exp(-0.5 * (np.arange(-reach, reach + 1) / spread) ** 2)
    window /= window.sum()
    before = 2 * path[0] - path[reach:0:-1]
    after = 2 * path[-1] - path[-2 : -reach - 2 : -1]
    longer = np.concatenate([before, path, after])
    result = np.empty_like(path)
    for axis in range(path.shape[1]):
        result[:, axis] = np.convolve(longer[:, axis], window, mode="valid")
    return result
