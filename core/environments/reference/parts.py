"""Where in its clips an episode begins: parts of clips, and how often episodes fail in each."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from core.environments.reference.frames import Frames
from core.environments.terms.reference import Adaptive, AnySampling

# A record is [2, parts] float32: how many steps of late failed in each part, and how many were in it at all.
Record = jax.Array


@dataclass(frozen=True)
class Parts:
    """All clips cut into parts of nearly equal length.

    starts, lengths: of the parts, in rows of `Frames`; no episode begins at a clip's last frame, which is in
    none of these lengths. of_frame: the part of each row. shares: how likely an episode begins in each part
    where nothing is known of failures. is_last: 1 where a part is its clip's last one.
    """

    sampling: AnySampling
    starts: np.ndarray
    lengths: np.ndarray
    of_frame: np.ndarray
    shares: np.ndarray
    is_last: np.ndarray

    @classmethod
    def of(cls, sampling: AnySampling, frames: Frames, control_step_s: float) -> "Parts":
        seconds = sampling.part_s if isinstance(sampling, Adaptive) else np.inf
        bounds = [_bounds(length - 1, seconds / control_step_s) for length in frames.lengths]
        starts = [clip + cuts[:-1] for clip, cuts in zip(frames.starts, bounds, strict=True)]
        lengths = [np.diff(cuts) for cuts in bounds]
        numbers = np.concatenate([np.full(len(one), clip) for clip, one in enumerate(lengths)])
        weights = np.concatenate(lengths) * frames.weights[numbers]
        ends = [np.append(one[:-1], one[-1] + 1) for one in lengths]
        return cls(
            sampling=sampling,
            starts=np.concatenate(starts).astype(np.int32),
            lengths=np.concatenate(lengths).astype(np.int32),
            of_frame=np.repeat(np.arange(len(numbers)), np.concatenate(ends)).astype(np.int32),
            shares=(weights / weights.sum()).astype(np.float32),
            is_last=np.append(np.diff(numbers) > 0, True).astype(np.float32),
        )

    @property
    def number(self) -> int:
        return len(self.starts)

    def probabilities(self, record: Record | None) -> jax.Array:
        """How likely an episode begins in each part, [parts]. record: None: nothing is known."""
        uniform = jnp.asarray(self.shares)
        if record is None or not isinstance(self.sampling, Adaptive):
            return uniform
        failed, visited = record
        likely = self._with_those_behind(failed / jnp.maximum(visited, 1.0)) * uniform
        total = jnp.sum(likely)
        adapted = jnp.where(total > 0, likely / jnp.maximum(total, 1e-12), uniform)
        return self.sampling.uniform * uniform + (1.0 - self.sampling.uniform) * adapted

    def _with_those_behind(self, levels: jax.Array) -> jax.Array:
        """Σ_k decay^k level_(i+k) over the parts of the same clip, [parts]."""
        decay = self.sampling.decay if isinstance(self.sampling, Adaptive) else 0.0
        kept = jnp.asarray(decay * (1.0 - self.is_last), jnp.float32)

        def add(behind: jax.Array, part: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            level, share = part
            summed = level + share * behind
            return summed, summed

        return jax.lax.scan(add, jnp.zeros(()), (levels, kept), reverse=True)[1]

    def draw(self, key: jax.Array, record: Record | None) -> jax.Array:
        """The row [] int32 at which an episode begins."""
        part_key, place_key = jax.random.split(key)
        part = jax.random.categorical(part_key, jnp.log(self.probabilities(record)))
        length = jnp.asarray(self.lengths)[part]
        within = jnp.floor(jax.random.uniform(place_key) * length).astype(jnp.int32)
        return jnp.asarray(self.starts)[part] + jnp.minimum(within, length - 1)

    def counted(self, record: Record, parts: jax.Array, failed: jax.Array) -> Record:
        """The record after an update. parts: [...] int32, where its steps were; failed: [...], 1 where the
        step ended its episode by a failure."""
        assert isinstance(self.sampling, Adaptive)  # noqa: S101 - another one has no record
        place, ends = parts.ravel(), failed.ravel()
        counts = jax.ops.segment_sum(
            jnp.stack([ends, jnp.ones_like(ends)], 1), place, num_segments=self.number
        )
        return self.sampling.memory * record + counts.T


def _bounds(num_frames: int, longest: float) -> np.ndarray:
    """Where the parts of a clip begin, and where the last one ends."""
    number = 1 if np.isinf(longest) else min(max(1, round(num_frames / longest)), num_frames)
    return np.round(np.linspace(0, num_frames, number + 1)).astype(int)
