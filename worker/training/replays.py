"""Replays: what the page needs to draw episodes in three dimensions (docs/replay.md)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from core.environments.trajectory import Episode
from core.rendering.replay.replay import replay_of, scene_of
from worker.protocol import Noted
from worker.render.motions import motion_of
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter

SCENE = "scene.glb"
# A rollout may have a thousand episodes; nobody looks at more than some of them.
MOST_EPISODES = 32


@dataclass
class ReplayWriter:
    """Keeps an attempt's replays; and the scene, which they share, before the first of them."""

    built: BuiltEnvironment
    events: EventWriter
    _has_scene: bool = False

    def keep(self, episodes: Sequence[Episode], suffix: str, step: int | None, **facts: Any) -> None:
        """Keep the replay of these episodes as `replay<suffix>.bin`. If that fails, a note says why.

        facts: on it, for its metadata.
        """
        shown = episodes[:MOST_EPISODES]
        motions = [motion_of(episode) for episode in shown]
        model, body = self.built.environment.model, self.built.environment.tracked_body
        of_each = [
            {"num_steps": one.num_steps, "duration_s": one.duration_s, "terminated": one.terminated}
            for one in shown
        ]
        try:
            scene = None if self._has_scene else scene_of(model, motions[0].qpos[0], body)
            content = replay_of(model, motions, [one.reward for one in shown], of_each, body)
        except Exception as error:  # Models of users may have anything in them; the job has its policy.
            self.events.send(Noted(text=f"There is no replay: {type(error).__name__}: {error}"))
            return
        if scene is not None:
            self.events.keep(SCENE, scene, "scene", "model/gltf-binary")
            self._has_scene = True
        self.events.keep(
            f"replay{suffix}.bin",
            content,
            "replay",
            "application/octet-stream",
            step=step,
            metadata={
                "episodes": len(shown),
                "of_episodes": len(episodes),
                "seconds": shown[0].duration_s,
                **facts,
            },
        )
