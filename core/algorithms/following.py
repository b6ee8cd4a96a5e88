"""How far a policy follows its reference: whole episodes from starts that are spread over all clips."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from core.algorithms.battery.run import on_the_cpu
from core.algorithms.trained_policy import TrainedPolicy
from core.environments.environment import TRUNCATED, State
from core.environments.reference.playback import FRAME, Playback
from core.environments.task import TaskEnv

_ERRORS = ("root_error", "root_turn_error", "joint_error", "body_error")
# The equal parts of a clip's time that have mean errors of their own; a short clip has fewer.
BINS = 50
# Steps in a call of the compiled program; between two calls a run may stop.
_STEPS_PER_CALL = 50


@dataclass(frozen=True)
class FollowingResult:
    """How episodes followed one clip, or all clips.

    starts: how many episodes there were. reached: the share of them that came to the clip's end. close: the
    share that came there with small mean errors. The errors are means over the steps of all episodes, in m
    and rad: see `FollowedReference`.
    """

    starts: int
    reached: float
    close: float
    root_error: float
    root_turn_error: float
    joint_error: float
    body_error: float

    def document(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class ErrorsOverTime:
    """Mean errors of the steps in each part of a clip's time; NaN where there was no step.

    joints: [bins, joints] in rad, or m of slides; bodies: [bins, bodies] in m: see
    `TaskEnv.reference_errors`.
    """

    joints: np.ndarray
    bodies: np.ndarray


def spread_over(environment: TaskEnv, number: int) -> np.ndarray:
    """Rows [number] of the reference's frames at equal distances, none of which is a clip's last frame."""
    frames = _playback(environment).frames
    can_begin = np.setdiff1d(np.arange(frames.lengths.sum()), frames.starts + frames.lengths - 1)
    return can_begin[np.linspace(0, len(can_begin) - 1, number).round().astype(int)].astype(np.int32)


def followed(
    environment: TaskEnv,
    policy: TrainedPolicy,
    rows: np.ndarray,
    *,
    seed: int,
    close: tuple[float, float] = (0.1, 0.15),
    is_stopped: Callable[[], bool] = lambda: False,
) -> tuple[FollowingResult, dict[str, FollowingResult], dict[str, ErrorsOverTime]]:
    """Run one episode from each of these rows; return the result of all, the result of each clip by its name,
    and each clip's errors over its time by its name.

    environment: of the engine `native`, whose metrics have the term `followed_reference`. policy: a
    deterministic one. rows: of the reference's frames. close: the largest mean errors of the root, in m, and
    of the joints, in rad, of an episode that counts as close. is_stopped: asked every few steps; once it is
    true, the episodes end where they are.
    """
    frames = _playback(environment).frames
    with on_the_cpu():
        begin, advance = _programs(environment, policy)
        joints, bodies = (len(names) for names in environment.compared)
        table = jnp.zeros((len(frames.starts) * BINS, 1 + joints + bodies))
        keys = jax.random.split(jax.random.key(seed), len(rows))
        nothing = {name: jnp.zeros(len(rows)) for name in ("steps", "reached", *_ERRORS)}
        running = (begin(keys, jnp.asarray(rows)), jnp.ones(len(rows)), nothing, table)
        for _ in range(0, int(frames.lengths.max()), _STEPS_PER_CALL):
            if is_stopped():
                break
            running = advance(policy.parameters, running)
        totals = {name: np.asarray(values, float) for name, values in running[2].items()}
        tables = np.asarray(running[3], float).reshape(len(frames.starts), BINS, -1)
    clip = np.searchsorted(frames.starts, rows, side="right") - 1
    of_clips = {
        name: _result(totals, clip == number, close)
        for number, name in enumerate(frames.names)
        if (clip == number).any()
    }
    over_time = {
        name: _over_time(table[: _bins(length)], joints)
        for name, length, table in zip(frames.names, frames.lengths, tables, strict=True)
    }
    return _result(totals, np.ones(len(rows), bool), close), of_clips, over_time


def _programs(environment: TaskEnv, policy: TrainedPolicy) -> tuple[Any, Any]:
    """The compiled functions `begin`, (keys, rows) -> states, and `advance`, (parameters, what runs) -> what
    runs some steps later."""
    acted, act = policy.acting(environment)
    # No step comes to a clip's first frame.
    places = [
        clip * BINS + np.maximum(np.arange(length) - 1, 0) * _bins(length) // (length - 1)
        for clip, length in enumerate(_playback(environment).frames.lengths)
    ]
    bin_of_row = np.concatenate(places).astype(np.int32)

    def begin(key: jax.Array, row: jax.Array) -> State:
        return policy.acting(environment.at_frame(row)).environment.reset(key)

    def step(parameters: Any, running: Any) -> Any:
        before, alive, sums = running
        state = acted.step(before, act(parameters, before, jax.random.key(0)))
        is_lost = ~jnp.all(jnp.isfinite(state.physics.qpos)) | ~jnp.all(jnp.isfinite(state.physics.qvel))
        now = {name: state.metrics[name] for name in _ERRORS}
        now |= {"steps": jnp.ones(()), "reached": state.info[TRUNCATED]}
        counts = (alive > 0) & ~is_lost
        added = {name: sums[name] + jnp.where(counts, now[name], 0.0) for name in sums}
        errors = jnp.concatenate([jnp.ones(1), *environment.reference_errors(state)])
        place = jnp.asarray(bin_of_row)[state.info[FRAME]]
        going_on = jnp.where(counts & (state.done == 0), 1.0, 0.0)
        return (state, going_on, added), (place, jnp.where(counts, errors, 0.0))

    def advance(parameters: Any, running: Any) -> Any:
        def one(running: Any, _: None) -> tuple[Any, None]:
            *episodes, table = running
            after, (places, errors) = jax.vmap(step, (None, 0))(parameters, tuple(episodes))
            return (*after, table.at[places].add(errors)), None

        return jax.lax.scan(one, running, length=_STEPS_PER_CALL)[0]

    return jax.jit(jax.vmap(begin)), jax.jit(advance)


def _bins(num_frames: int) -> int:
    return min(BINS, num_frames - 1)


def _over_time(table: np.ndarray, joints: int) -> ErrorsOverTime:
    """table: [bins, 1 + joints + bodies], sums over steps: of their number, and of the errors."""
    with np.errstate(invalid="ignore"):
        means = table[:, 1:] / table[:, :1]
    return ErrorsOverTime(means[:, :joints], means[:, joints:])


def _result(totals: dict[str, np.ndarray], chosen: np.ndarray, close: tuple[float, float]) -> FollowingResult:
    of_episodes = {name: values[chosen] for name, values in totals.items()}
    steps, reached = of_episodes["steps"], of_episodes["reached"] > 0
    errors = {name: float(of_episodes[name].sum() / max(steps.sum(), 1.0)) for name in _ERRORS}
    is_close = reached.copy()
    for name, most in zip(("root_error", "joint_error"), close, strict=True):
        is_close &= of_episodes[name] <= most * steps
    return FollowingResult(int(chosen.sum()), float(reached.mean()), float(is_close.mean()), **errors)


def _playback(environment: TaskEnv) -> Playback:
    if environment.playback is None:
        raise ValueError("The task follows no reference.")
    return environment.playback
