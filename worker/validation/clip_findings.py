"""Examines a file of clips: reads it as clips of its body, and makes a replay of them."""

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from core.clips import archive
from core.clips.clip import Clip
from core.clips.kinematics import qpos
from core.clips.reading import read
from core.clips.record import ARCHIVE, MOST_REPLAYED, REPLAY, SCENE, ClipFacts, ClipsDescription
from core.clips.skeleton import skeleton_of
from core.environments import catalog
from core.environments.mjcf.model import read as read_model
from core.environments.task_model import compiled
from core.environments.terms.describe import root_of
from core.errors import BadClips, GaitwayError
from core.physics.choose import engine_builder
from core.rendering.replay.replay import replay_of, scene_of
from core.rendering.timeline import EpisodeMotion
from worker.confinement.confinement import allow_cpu
from worker.validation.answer import ClipsQuestion, write_progress

# Of all clips together: what a look at them needs.
_MOST_FRAMES = 20_000
# Key points are fitted at some hundred frames a second.
_TELLS_EVERY = 100


def clip_findings(folder: Path) -> ClipsDescription:
    """The description. It leaves what is made of the file in the folder. Raises BadClips."""
    question = ClipsQuestion.model_validate_json((folder / "question.json").read_text())
    model = _body(question.body, folder)

    def begin(frame: int, num_frames: int) -> None:
        if frame % _TELLS_EVERY == 0:
            write_progress(folder, frame, num_frames)

    found = read(
        folder / "clips", model, rate=question.rate, name=question.name, allow=allow_cpu, begin=begin
    )
    (folder / ARCHIVE).write_bytes(archive.to_bytes(found.clips))
    shown, why = _replayed(found.clips, model, folder)
    return ClipsDescription(
        format=found.format,
        clips=[
            ClipFacts(
                name=clip.name,
                num_frames=clip.num_frames,
                rate=clip.rate,
                seconds=clip.duration_s,
                warnings=list(warnings),
            )
            for clip, warnings in zip(found.clips, found.warnings, strict=True)
        ],
        joints=list(found.clips[0].joints),
        key_points=list(found.key_points),
        num_replayed=shown,
        no_replay=why,
    )


def _body(body: str, folder: Path) -> mujoco.MjModel:
    """Raises BadClips where this worker has no model of the body."""
    try:
        if body.startswith("sha256:"):
            with read_model(folder / "model") as (spec, _):
                return compiled(spec)
        info = catalog.find(body)
        return catalog.make(info, info.option_values, engine_builder("native")).model
    except GaitwayError as error:
        raise BadClips(f"The body {body} cannot be made here: {error.detail}") from None


def _replayed(clips: Sequence[Clip], model: mujoco.MjModel, folder: Path) -> tuple[int, str | None]:
    """How many of the clips the replay shows that now lies in the folder; if none, why."""
    shown: list[Clip] = []
    for clip in clips[:MOST_REPLAYED]:
        if sum(one.num_frames for one in (*shown, clip)) > _MOST_FRAMES:
            break
        shown.append(clip)
    if not shown:
        return 0, f"Its first clip has more than {_MOST_FRAMES:,} frames."
    skeleton, root = skeleton_of(model), root_of(model)
    motions = [EpisodeMotion(np.arange(clip.num_frames) / clip.rate, qpos(clip, skeleton)) for clip in shown]
    facts = [
        {
            "num_steps": clip.num_frames - 1,
            "duration_s": clip.duration_s,
            "terminated": False,
            "name": clip.name,
        }
        for clip in shown
    ]
    rewards = [np.zeros(clip.num_frames - 1) for clip in shown]
    try:
        scene = scene_of(model, motions[0].qpos[0], root)
        content = replay_of(model, motions, rewards, facts, root)
    except Exception as error:  # Models of users may have anything in them; the clips can be used.
        return 0, f"It cannot be drawn: {type(error).__name__}: {error}"[:500]
    (folder / SCENE).write_bytes(scene)
    (folder / REPLAY).write_bytes(content)
    return len(shown), None
