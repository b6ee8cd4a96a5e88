"""The plane in which a layer's values vary most, for a picture of them (docs/neuroscience.md)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.algorithms.layers import LATENT_MEAN, POLICY
from core.environments.recording import clips_at
from core.environments.trajectory import Episode, FollowedClip

_MOST_POINTS = 2000


def principal_components(values: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rows [T, n] along their two directions of most variance, [T, 2]; and each direction's share of all
    variance, [2].

    The greatest component of a direction is positive, so that the same values give the same picture.
    """
    values = np.column_stack([values, np.zeros(len(values))])  # A row of one number needs a second.
    centred = values - values.mean(axis=0)
    _, deviations, directions = np.linalg.svd(centred, full_matrices=False)
    directions = np.pad(directions[:2], ((0, max(0, 2 - len(directions))), (0, 0)))  # Of one row.
    greatest = np.take_along_axis(directions, abs(directions).argmax(axis=1, keepdims=True), axis=1)
    shares = deviations**2 / max(np.sum(deviations**2), 1e-12)
    return centred @ (directions * np.where(greatest < 0, -1, 1)).T, np.append(shares, 0.0)[:2]


def plotted_layer(chosen: Sequence[str], layers: Sequence[str]) -> str | None:
    """The layer to look at among those that are recorded: the intention, or else a perceptron's last hidden
    one. layers: all that the policy has."""
    *hidden, _ = [name for name in layers if name.startswith(f"{POLICY}/")] or [""]
    return next((name for name in (LATENT_MEAN, *hidden[-1:]) if name in chosen), None)


@dataclass
class LatentPoints:
    """Gathers a layer's values at every n-th step, so that there are few enough points to draw.

    num_steps: the most steps that all episodes have together. clips: those that the body follows.
    """

    layer: str
    num_steps: int
    clips: Sequence[FollowedClip]
    _values: list[NDArray[np.float32]] = field(default_factory=list[Any])
    _where: list[NDArray[np.float64]] = field(default_factory=list[Any])

    def add(self, episode: Episode, values: NDArray[np.float32]) -> None:
        """values: [T, size]."""
        chosen = np.arange(0, len(values), -(-self.num_steps // _MOST_POINTS))
        clip, share = np.full(len(values), -1), np.zeros(len(values))
        if episode.reference_frame is not None:
            clip, frame = clips_at(self.clips, episode.reference_frame[:-1])
            share = frame / np.array([one.num_frames for one in self.clips])[clip]
        number = np.full(len(values), len(self._where))
        self._values.append(values[chosen])
        self._where.append(np.stack([number, episode.time[:-1], clip, share], 1, dtype=float)[chosen])

    def document(self) -> dict[str, Any] | None:
        """The points that the picture shows, as a document; None: there are none.

        `x`, `y`, `episode`, `time_s` have an entry for each point: its places along the two components, its
        episode and its time; for a body that follows clips also `clip`, its clip's number in `clips`, and
        `share`, how much of that clip is over. `variance`: each component's share of all variance.
        """
        if not self._where:
            return None
        points, variance = principal_components(np.concatenate(self._values))
        episode, time, clip, share = np.concatenate(self._where).T
        where: dict[str, Any] = {"episode": episode.astype(int).tolist(), "time_s": time.round(3).tolist()}
        if self.clips:
            where |= {"clip": clip.astype(int).tolist(), "share": share.round(3).tolist()}
        return {
            "layer": self.layer,
            "size": self._values[0].shape[1],
            "variance": variance.round(4).tolist(),
            "clips": [one.name for one in self.clips],
            "x": [float(f"{one:.5g}") for one in points[:, 0]],
            "y": [float(f"{one:.5g}") for one in points[:, 1]],
            **where,
        }
