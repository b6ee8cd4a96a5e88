"""A reference while episodes run: which frame each environment is at, and what its terms see of that."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments.reference.frames import Frames, chosen_clips, frames_of
from core.environments.reference.parts import Parts, Record
from core.environments.terms.actions import AnyAction, JointAction, PositionPart
from core.environments.terms.actuation import joint_names
from core.environments.terms.reference import Adaptive, Following, Frame, Reference
from core.environments.terms.step import ModelIndex
from core.environments.trajectory import FollowedClip

# Entries of `State.info`, [] int32: the row of `Frames` that the body is at, and where the episode began.
FRAME, FIRST_FRAME = "reference_frame", "reference_first_frame"


class Playback:
    """The frames of all clips, along which an episode moves by one in each control step."""

    def __init__(self, reference: Reference, frames: Frames, control_step_s: float) -> None:
        self._random_phase = reference.random_phase
        self._ahead = np.array(reference.ahead.steps(control_step_s), np.int32)
        self._rows = frames.frames
        clip = np.repeat(np.arange(len(frames.lengths)), frames.lengths)
        self._first = frames.starts[clip].astype(np.int32)
        self._last = (frames.starts + frames.lengths - 1)[clip].astype(np.int32)
        self.frames = frames
        self.parts = Parts.of(reference.sampling, frames, control_step_s)

    @classmethod
    def of(
        cls, reference: Reference, model: ModelIndex, control_step_s: float, files: Mapping[str, Path]
    ) -> "Playback":
        clips = list(chosen_clips(reference.clips, files, 1.0 / control_step_s, model.model))
        return cls(reference, frames_of(clips, model.model, model.followed, model.pose), control_step_s)

    @property
    def clips(self) -> Sequence[FollowedClip]:
        """See `HasClips`."""
        return [
            FollowedClip(name, int(start), int(length))
            for name, start, length in zip(
                self.frames.names, self.frames.starts, self.frames.lengths, strict=True
            )
        ]

    def positions(self, frames: np.ndarray) -> np.ndarray:
        """See `HasClips`."""
        return np.asarray(self.frames.frames.qpos)[frames]

    @property
    def adaptive_parts(self) -> Parts | None:
        """See `HasClipParts`."""
        return self.parts if isinstance(self.parts.sampling, Adaptive) else None

    def start(self, key: jax.Array, record: Record | None) -> jax.Array:
        """The row [] int32 at which an episode begins."""
        key, phase_key = jax.random.split(key)
        row = self.parts.draw(key, record)
        if self._random_phase == 1.0:
            return row
        is_random = jax.random.uniform(phase_key) < self._random_phase
        return jnp.where(is_random, row, jnp.asarray(self._first)[row])

    def state(self, row: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Positions [nq] and velocities [nv] of a row."""
        return jnp.asarray(self._rows.qpos)[row], jnp.asarray(self._rows.qvel)[row]

    def following(self, row: jax.Array, first: jax.Array) -> Following:
        """The reference in the step that came to a row, of an episode that began at the row `first`."""
        last = jnp.asarray(self._last)[row]
        ahead = jnp.minimum(row + jnp.asarray(self._ahead), last)
        way = jnp.maximum(last - first, 1).astype(jnp.float32)
        return Following(self._at(row), self._at(ahead), 1.0 / way)

    def is_over(self, row: jax.Array) -> jax.Array:
        """1 where the row is its clip's last one, otherwise 0; []."""
        return jnp.where(row >= jnp.asarray(self._last)[row], 1.0, 0.0)

    def _at(self, rows: jax.Array) -> Frame:
        return Frame(*(jnp.asarray(values)[rows] for values in self._rows))


def servos_along(action: AnyAction, model: mujoco.MjModel) -> np.ndarray:
    """The servos whose targets are about the reference, and their joints' places in qpos, [2, n]."""
    names = joint_names(model)
    parts = (
        [part for part in action.parts if isinstance(part, PositionPart)]
        if isinstance(action, JointAction)
        else []
    )
    along = [part for part in parts if part.about == "reference"]
    servos = [number for number, name in enumerate(names) if any(part.drives(name) for part in along)]
    return np.array([servos, model.jnt_qposadr[model.actuator_trnid[servos, 0]]], int).reshape(2, -1)
