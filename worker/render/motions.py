"""Episodes as the motions that are drawn."""

from core.environments.trajectory import Episode
from core.rendering.timeline import Motion


def motion_of(episode: Episode) -> Motion:
    """The part of an episode that is drawn."""
    return Motion(
        episode.time,
        episode.qpos.astype("float64"),
        None if episode.target is None else episode.target.astype("float64"),
        episode.arena,
    )
