"""The last states of the first body that a training lost, as numbers and as a replay."""

import io
import json
from typing import Any

import numpy as np

from core.algorithms.events import BodyLost
from core.environments.trajectory import Episode
from worker.protocol import Noted
from worker.training.built_environment import BuiltEnvironment
from worker.training.event_writer import EventWriter
from worker.training.video import ReplayWriter

_ROWS = (
    "Row i of qpos, qvel, action and reward: a state, in MuJoCo's units, the action in it, and what it led "
    "to. After the last row's action the state was not finite. dt_s: between two rows."
)


def keep_lost_body(
    lost: BodyLost, *, built: BuiltEnvironment, action_repeat: int, events: EventWriter
) -> None:
    """Keep them as `lost-body.npz` and `replay-lost.bin`, and tell of it by a note.

    action_repeat: time steps for which an action is held.
    """
    own, dt = lost.steps, built.environment.dt * action_repeat
    events = events if lost.seed is None else events.of_seed(lost.seed)
    about = {"environment": built.info.id, "step": lost.step, "env": lost.env, "engine": built.engine}
    about |= {"dt_s": dt, "rows": _ROWS, **({} if lost.seed is None else {"seed": lost.seed})}
    file = io.BytesIO()
    arrays: dict[str, Any] = {"qpos": own.qpos, "qvel": own.qvel, "action": own.action, "reward": own.reward}
    np.savez_compressed(file, about=np.array(json.dumps(about)), **arrays)
    number = len(own.reward)
    facts = {"states": number, "env": lost.env}
    content, kind = file.getvalue(), "application/x-npz"
    events.keep("lost-body.npz", content, "lost_body", kind, step=lost.step, metadata=facts)
    ReplayWriter(built, events).keep([_episode(lost, dt)], "-lost", lost.step, lost_body=True)
    where = f"the replay of step {lost.step} and lost-body.npz"
    events.send(Noted(text=f"The last {number} states of the first body that was lost are in {where}."))


def _episode(lost: BodyLost, dt: float) -> Episode:
    """The states as an episode; its last action has no next state, and is left out."""
    own = lost.steps
    states = np.asarray(own.qpos, np.float32)
    length = len(states) - 1
    return Episode(
        time=np.arange(length + 1, dtype=np.float64) * dt,
        qpos=states,
        qvel=np.asarray(own.qvel, np.float32),
        position=np.zeros((length + 1, 3), np.float32),
        observation=np.zeros((length + 1, 0), np.float32),
        action=np.asarray(own.action[:length], np.float32),
        reward=np.asarray(own.reward[:length], np.float32),
        terminated=True,
        target=None if own.target is None else np.asarray(own.target, np.float32),
    )
