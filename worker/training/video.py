"""Videos and replays of a policy: episodes in the compiled environment.

The render process draws a video. A replay holds what the page needs to draw episodes in three dimensions
(docs/replay.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import mujoco
import numpy as np

from core.environments import trajectory
from core.environments.rollout import Roller, footage, trajectory_of
from core.environments.trajectory import Episode, Trajectory
from core.jobs.spec import RolloutSpec, TrainSpec, VideoSpec
from core.rendering.gl import RenderingFailed
from core.rendering.replay.replay import replay_of, scene_of
from core.rendering.request import RenderRequest, RenderResult
from worker.host.disk import is_full, what_to_do
from worker.protocol import Noted
from worker.render.client import render
from worker.render.process import motion_of
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter
from worker.training.pictures import kept_with_path

SCENE = "scene.glb"
# A rollout may have a thousand episodes; nobody looks at more than some of them.
MOST_EPISODES = 32
# A camera's picture takes a tenth of a second on the slowest software renderer seen; twice that, to be sure.
_SECONDS_PER_FRAME = 0.2
_START_UP_S = 60.0


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


def no_video(why: str, spec: TrainSpec | RolloutSpec) -> str:
    """Why there is none, and what shows the same. why: a sentence."""
    later = "; `gaitway rollout JOB` draws a video later" if isinstance(spec, TrainSpec) else ""
    return f"There is no video: {why} The replay on the job's page shows the same episodes{later}."


@dataclass(frozen=True)
class VideoRecorder:
    """Makes a job's videos. roller: acts by the policy, in `video.episodes` episodes side by side."""

    spec: TrainSpec | RolloutSpec
    video: VideoSpec
    built: BuiltEnvironment
    roller: Roller
    events: EventWriter
    replays: ReplayWriter

    def shoot(self, name: str, parameters: Any, step: int | None) -> None:
        """Make a video of these parameters as `<name>.mp4`, with its poster `<name>.png`.

        Also keeps what it shows: as numbers, `trajectory….npz`, from above, `path….png`, and from any side,
        `replay….bin`.
        """
        episodes = self._episodes(parameters)
        if not episodes:
            return
        chosen = self.spec.environment
        shown = trajectory_of(
            self.built.environment, episodes, environment=chosen.model_dump(), seed=self.spec.seed
        )
        suffix = name.removeprefix("video")
        with kept_with_path(self.events, shown, suffix, step, f"{chosen.id}: path from above"):
            self.replays.keep(episodes, suffix, step)
            self.show(name, episodes, step)

    def replay(self, suffix: str, parameters: Any, step: int) -> None:
        """Keep what a video of these parameters would show, without drawing it."""
        if episodes := self._episodes(parameters):
            self.replays.keep(episodes, suffix, step)

    def show(self, name: str, episodes: Sequence[Episode], step: int | None) -> None:
        """Make a video of these episodes. If that fails, the job continues without it; a note says why."""
        shown = trajectory_of(self.built.environment, episodes, environment=self.built.info.id)
        try:
            result = self._drawn(name, shown)
        except RenderingFailed as error:
            self.events.send(Noted(text=no_video(error.detail, self.spec)))
            return
        speed = trajectory.summary(shown)["mean"]["forward_speed_m_s"]
        facts = {**result.model_dump(), "forward_speed_m_s": speed, "episodes": len(episodes)}
        self.events.hand_over(f"{name}.mp4", "video", "video/mp4", step=step, metadata=facts)
        self.events.hand_over(f"{name}.png", "poster", "image/png", step=step, metadata=facts)

    def _drawn(self, name: str, shown: Trajectory) -> RenderResult:
        spool, video = self.events.spool, self.video
        model = self.built.environment.model
        compiled = np.empty(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, compiled)
        try:
            # Written by ourselves: MuJoCo reports no error if the disk is full.
            (spool / "model.mjb").write_bytes(compiled.tobytes())
            trajectory.save(spool / "shown.npz", shown)
            request = RenderRequest(
                trajectory=spool / "shown.npz",
                model=spool / "model.mjb",
                tracked_body=self.built.environment.tracked_body,
                video=spool / f"{name}.mp4",
                poster=spool / f"{name}.png",
                cameras=video.shown,
                **video.model_dump(
                    include={"show", "reference", "episodes", "width", "height", "fps", "seconds"}
                ),
            )
            num_pictures = video.fps * video.seconds * len(video.shown) * video.episodes
            return render(request, timeout_s=_START_UP_S + _SECONDS_PER_FRAME * num_pictures)
        except OSError as error:
            if not is_full(error):
                raise
            raise RenderingFailed("disk_full", what_to_do()) from error

    def _episodes(self, parameters: Any) -> list[Episode]:
        """None, and a note, where the physics did not stay finite: such numbers cannot be drawn."""
        episodes = footage(
            self.roller,
            parameters,
            jax.random.PRNGKey(self.spec.seed),
            dt=self.built.environment.dt,
            seconds=self.video.seconds,
            num_at_once=self.video.episodes,
        )
        for found in filter(None, map(trajectory.not_finite, episodes)):
            step, quantity = found
            text = f"There is no video and no replay: the {quantity} became non-finite at its step {step}."
            self.events.send(Noted(text=text))
            return []
        return episodes
