"""The render process: `python -m worker.render.process REQUEST.json`. It loads no JAX.

It prints one JSON line: a RenderResult, and exits with 0, or a RenderFailure, and exits with another status.
Its caller sets MUJOCO_GL.
"""

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from core.errors import Rejected
from core.rendering.gl import context_works
from core.rendering.request import RenderFailure, RenderRequest, RenderResult
from worker.host.disk import is_full, what_to_do
from worker.host.processes import die_with_parent

if TYPE_CHECKING:
    from core.environments.trajectory import Episode
    from core.rendering.timeline import EpisodeMotion

NO_GL, BAD_REQUEST = 3, 4
# A measured velocity swings with each step of a gait: this is its mean, as on the drive page.
_CALM_S = 0.3


def main(arguments: list[str]) -> int:
    die_with_parent()
    # A signal to the whole group is meant for the parent, which may still want this video.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    request = RenderRequest.model_validate_json(Path(arguments[0]).read_bytes())
    try:
        context_works()
    except Exception as error:  # whatever GL raises means the same to our caller
        return _answer(RenderFailure(reason="no_gl", message=f"{type(error).__name__}: {error}"), NO_GL)
    try:
        return _answer(_draw(request), 0)
    except (Rejected, ValueError, OSError) as error:
        message = what_to_do() if is_full(error) else str(error)
        return _answer(RenderFailure(reason="bad_request", message=message), BAD_REQUEST)


def _draw(request: RenderRequest) -> RenderResult:
    # Imported here: only a process with working GL needs them.
    from core.environments import trajectory
    from core.rendering.clip import draw, load_model

    motions = [motion_of(episode) for episode in trajectory.load(request.trajectory).episodes]
    if not request.reference:
        motions = [replace(motion, reference=None) for motion in motions]
    return draw(request, load_model(request.model), motions, gl_backend=os.environ.get("MUJOCO_GL", ""))


def _answer(answer: RenderResult | RenderFailure, status: int) -> int:
    sys.stdout.write(answer.model_dump_json() + "\n")
    sys.stdout.flush()
    return status


def motion_of(episode: "Episode") -> "EpisodeMotion":
    """The part of an episode that is drawn."""
    import numpy as np

    from core.rendering.timeline import EpisodeMotion, calmed

    velocities = None
    if episode.command is not None and episode.velocity is not None:
        measured = calmed(episode.time, episode.velocity.astype("float64"), spread_s=_CALM_S)
        velocities = np.stack([episode.command[:, :3].astype("float64"), measured], axis=1)
    return EpisodeMotion(
        episode.time,
        episode.qpos.astype("float64"),
        None if episode.target is None else episode.target.astype("float64"),
        episode.arena,
        velocities,
        None if episode.reference is None else episode.reference.astype("float64"),
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
