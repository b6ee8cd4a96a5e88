"""A body in MuJoCo's viewer, or in a video where there is no display: `gaitway play`."""

import copy
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, Protocol, cast

import mujoco
import typer

from core.environments import trajectory
from core.environments.catalog import resolve
from core.environments.trajectory import Episode
from core.errors import Rejected
from core.jobs.spec import RolloutSpec
from core.rendering.replay.poses import target_body
from core.rendering.scene import following_view
from core.rendering.timeline import EpisodeMotion, Floats, shots
from gaitway.service.foreground import Told, begin
from worker.protocol import Task
from worker.render.process import motion_of
from worker.stopping import StopRequest

_FRAMES_PER_SECOND = 60
_SPACE, _ENTER = 32, 257
KEYS = "Space pauses, Enter begins the next episode; close the window or press Ctrl-C to end."


class Viewer(Protocol):
    """The part of `mujoco.viewer.Handle` that is used here."""

    @property
    def cam(self) -> Any: ...

    def is_running(self) -> bool: ...

    def lock(self) -> AbstractContextManager[None]: ...

    def sync(self) -> None: ...


@dataclass
class Keys:
    """The state of the keys that a user pressed in the viewer, which calls it with GLFW's numbers."""

    paused: bool = False
    skips: bool = False

    def __call__(self, key: int) -> None:
        self.paused ^= key == _SPACE
        self.skips |= key == _ENTER


def play(
    spec: RolloutSpec,
    out: Path,
    *,
    model: Path | None,
    policy: tuple[Path, str | None] | None,
    in_viewer: bool,
) -> Path | None:
    """Show episodes until the user closes the viewer; or keep those of the specification in `out`.

    out: a folder, which is the working directory afterwards. model: the user's own. policy: its file, and the
    algorithm, which is None if the file is a checkpoint. Returns the video, if it made one. Raises
    GaitwayError where the environment or the policy cannot be loaded.
    """
    resolve(spec.environment.id, spec.environment.options)  # Refused before there is a folder.
    file, algorithm = policy or (None, None)
    task = begin(spec, out, device="cpu", model=model, checkpoint=file and str(file))
    task = task.model_copy(update={"policy_of": algorithm})
    events = Told(Path.cwd(), keeps_rows=False)
    # They import JAX, which reads the device's variables.
    from worker.training.built_environment import build_environment
    from worker.training.roll_out import roll_out

    if in_viewer:
        _view(task, spec, events)
        return None
    roll_out(task, spec, build_environment(task), events, StopRequest())
    video = Path.cwd() / "video.mp4"
    return video if video.exists() else None


def _view(task: Task, spec: RolloutSpec, events: Told) -> None:
    import jax
    from mujoco.viewer import launch_passive

    from core.environments.rollout import Roller
    from worker.training.built_environment import build_environment
    from worker.training.roll_out import actor

    built = build_environment(task)
    events.send(built.started())
    policy, environment, _ = actor(task, spec, built, events)
    episodes = Roller(environment, policy).episodes(
        None, jax.random.PRNGKey(spec.seed), num_steps=spec.num_steps, num_episodes=None
    )
    first = next(episodes)  # It is compiled first: no window stays empty for that long.
    model, keys = copy.copy(environment.model), Keys()
    data = mujoco.MjData(model)
    try:
        window = launch_passive(model, data, key_callback=keys, show_left_ui=False, show_right_ui=False)
    except RuntimeError as error:  # macOS draws in the main thread alone, which `mjpython` keeps for it.
        raise Rejected(f"{error}: `mjpython .venv/bin/gaitway play …`.") from None
    with window as viewer:
        typer.echo(KEYS)
        player = Player(cast("Viewer", viewer), model, data, keys)
        player.show(chain([first], episodes), body=environment.tracked_body)


@dataclass
class Player:
    """Shows episodes in real time, one after the other.

    model, data: those of the viewer; they change. sleep: waits for this many seconds.
    """

    viewer: Viewer
    model: mujoco.MjModel
    data: mujoco.MjData
    keys: Keys = field(default_factory=Keys)
    sleep: Callable[[float], None] = time.sleep

    def show(self, episodes: Iterable[Episode], *, body: int) -> None:
        """Until the viewer is closed. body: the one that the camera follows. An episode whose numbers do not
        stay finite is shown up to there."""
        for number, episode in enumerate(_finite(episodes)):
            if number == 0:
                self._look_at(body, episode.qpos[0].astype("float64"))
            self.keys.skips = False
            for is_on in self._frames(motion_of(episode)):
                if not is_on:
                    return
                if self.keys.skips:
                    break

    def _frames(self, motion: EpisodeMotion) -> Iterator[bool]:
        """Shows a frame, and yields whether the viewer is still open."""
        for shot in shots(self.model, [motion], fps=_FRAMES_PER_SECOND, seconds=max(motion.duration_s, 1e-9)):
            for name, values in shot.model.items():
                getattr(self.model, name)[:] = values
            for row, qpos in enumerate(shot.qpos):
                self._put(qpos, None if shot.target is None else shot.target[row])
                while self.keys.paused and not self.keys.skips and self.viewer.is_running():
                    self._draw()
                yield self.viewer.is_running()

    def _put(self, qpos: Floats, target: Floats | None) -> None:
        mark = target_body(self.model)
        with self.viewer.lock():
            if target is not None and mark is not None:
                self.model.body_pos[mark, : len(target)] = target
            self.data.qpos[:] = qpos
            mujoco.mj_forward(self.model, self.data)
        self._draw()

    def _draw(self) -> None:
        self.viewer.sync()
        self.sleep(1 / _FRAMES_PER_SECOND)

    def _look_at(self, body: int, qpos: Floats) -> None:
        """Place the camera where that of a video stands."""
        view = following_view(self.model, qpos, body)
        camera = self.viewer.cam
        with self.viewer.lock():
            camera.azimuth, camera.elevation, camera.distance = view.azimuth, view.elevation, view.distance
            camera.lookat[:] = view.centre
            if view.body is not None:
                camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, view.body


def _finite(episodes: Iterable[Episode]) -> Iterator[Episode]:
    from core.environments.rollout import cut

    for number, episode in enumerate(episodes):
        if (bad := trajectory.not_finite(episode)) is not None:
            step, quantity = bad
            typer.echo(f"Episode {number}: the {quantity} became non-finite at step {step}.", err=True)
            if step == 0:
                return
            episode = cut(episode, step - 1)
        typer.echo(f"Episode {number}: {episode.num_steps} steps, return {episode.reward.sum():,.1f}")
        yield episode


def has_display() -> bool:
    """Whether a window can be opened: MuJoCo's viewer waits for ever where it cannot."""
    if sys.platform == "darwin":
        return True
    if sys.platform.startswith("linux") and not (os.environ.keys() & {"DISPLAY", "WAYLAND_DISPLAY"}):
        return False
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not glfw.init():
            return False
        glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
        window = glfw.create_window(64, 64, "gaitway", None, None)
        glfw.terminate()
        return bool(window)
