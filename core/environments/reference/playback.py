"""The part of a task that follows a reference: where its episodes begin in the clips, which frame each is at,
and what its terms see of that.
"""

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from core.environments.reference.frames import Frames, chosen_clips, frames_of
from core.environments.reference.parts import Parts, Record
from core.environments.terms.reference import Adaptive, Following, Frame, Reference
from core.environments.terms.step import ModelIndex
from core.environments.trajectory import FollowedClip

# Entries of `State.info`, [] int32: the row of `Frames` that the body is at, and where the episode began.
FRAME, FIRST_FRAME = "reference_frame", "reference_first_frame"


class Playback:
    """The frames of all clips, along which an episode moves by one in each control step."""

    def __init__(self, reference: Reference, frames: Frames, control_step_s: float) -> None:
        self._row: jax.Array | None = None
        self._record: Record | None = None
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
        """The playback of a task. files: of clips, by their ids."""
        clips = list(chosen_clips(reference.clips, files, 1.0 / control_step_s, model.model))
        frames = frames_of(clips, model.model, model.followed, model.pose)
        return cls(reference, frames, control_step_s)

    @property
    def clips(self) -> Sequence[FollowedClip]:
        """See `HasClips`."""
        frames = self.frames
        return [
            FollowedClip(name, int(start), int(length))
            for name, start, length in zip(frames.names, frames.starts, frames.lengths, strict=True)
        ]

    def positions(self, frames: np.ndarray) -> np.ndarray:
        """See `HasClips`."""
        return np.asarray(self._rows.qpos)[frames]

    @property
    def adaptive_parts(self) -> Parts | None:
        """See `HasClipParts`."""
        return self.parts if isinstance(self.parts.sampling, Adaptive) else None

    def under_record(self, record: Record) -> "Playback":
        """See `HasClipParts`."""
        there = copy.copy(self)
        there._record = record
        return there

    def at_frame(self, row: jax.Array) -> "Playback":
        """The playback whose episodes begin at this row [] int32 of the frames."""
        there = copy.copy(self)
        there._row = row
        return there

    def start(self, key: jax.Array) -> jax.Array:
        """The row [] int32 at which an episode begins."""
        if self._row is not None:
            return self._row
        key, phase_key = jax.random.split(key)
        row = self.parts.draw(key, self._record)
        if self._random_phase == 1.0:
            return row
        is_random = jax.random.uniform(phase_key) < self._random_phase
        return jnp.where(is_random, row, jnp.asarray(self._first)[row])

    def state(self, row: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Positions [nq] and velocities [nv] of a row."""
        return jnp.asarray(self._rows.qpos)[row], jnp.asarray(self._rows.qvel)[row]

    def activations(self, row: jax.Array) -> jax.Array | None:
        """The states of actuators [na] at a row; None where those of all rows are 0."""
        known = self.frames.activations
        return jnp.asarray(known)[row] if known.any() else None

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
