"""Running a policy in an environment, and recording its episodes."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import islice
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from core.compilation import compiling
from core.environments.environment import Environment, State, Wrapped, innermost, terminated
from core.environments.info import POLICY_GROUP
from core.environments.trajectory import ARENA, Episode, FollowedClip, Trajectory, describe

# (observation [observation_size], or several by name, key) -> action [action_size]
Policy = Callable[[Any, jax.Array], jax.Array]
# (parameters, state, key) -> action: parameters may change without another compilation.
ParametricPolicy = Callable[[Any, State, jax.Array], jax.Array]

# The entry of an environment's `info` with the tracked body's target position: [2 or 3], in metres.
TARGET = "target_position"

# Larger than any number that a key is split into: a reset draws from the first of these.
_OF_ACTIONS = 0x616374
_STEPS_PER_CALL = 200
_MAX_ENVS = 64


@runtime_checkable
class HasCommand(Protocol):
    """The attribute of an environment that may tell its tracked body what to do."""

    @property
    def recorded(self) -> Mapping[str, str]:
        """The entries of `State.info` that are an episode's `command`, `target` or `reference_frame`, by
        these names."""
        ...


@runtime_checkable
class HasClips(Protocol):
    """The attribute of an environment whose body may follow clips."""

    @property
    def clips(self) -> Sequence[FollowedClip]:
        """In the order in which `reference_frame` counts their frames; none without a reference."""
        ...

    def reference_positions(self, frames: NDArray[np.int32]) -> NDArray[np.float32]:
        """The positions [N, nq] of these frames [N] of the clips; there are some."""
        ...


def clips_of(environment: Environment) -> Sequence[FollowedClip]:
    """The clips that the body follows; none where it follows none."""
    inner = innermost(environment)
    return inner.clips if isinstance(inner, HasClips) else ()


def action_keys(key: jax.Array, episode: int, num_steps: int) -> jax.Array:
    """The keys [num_steps] with which a policy acts in an episode of `Roller.episodes` under this key."""
    of_episode = jax.random.fold_in(jax.random.fold_in(key, episode), _OF_ACTIONS)
    return jax.vmap(jax.random.fold_in, (None, 0))(of_episode, jnp.arange(num_steps))


def random_policy(action_size: int) -> Policy:
    """Each component uniform in [-1, 1]."""
    return lambda observation, key: jax.random.uniform(key, (action_size,), minval=-1.0, maxval=1.0)


def constant_policy(action: Sequence[float]) -> Policy:
    """Always the same action."""
    fixed = np.asarray(action, np.float32)
    return lambda observation, key: jnp.asarray(fixed)


def zero_policy(action_size: int) -> Policy:
    """No action at all."""
    return constant_policy([0.0] * action_size)


class Roller:
    """Compiles a policy's episodes in an environment once, for parameters of the first ones' shapes and any
    seed, length and number.

    num_envs: episodes that run side by side; results do not depend on it.
    """

    def __init__(self, environment: Environment, policy: ParametricPolicy, *, num_envs: int = 1) -> None:
        self._environment = environment
        self._num_envs = num_envs
        self._reset = jax.jit(jax.vmap(environment.reset))
        self._advance = jax.jit(lambda *state: _advance(environment, policy, *state))
        self._compiled: Sequence[Callable[..., Any]] = ()

    def episodes(
        self, parameters: Any, key: jax.Array, *, num_steps: int, num_episodes: int | None
    ) -> Iterator[Episode]:
        """Episodes of at most `num_steps` actions, one after the other; endless if `num_episodes` is None.

        Episode i depends only on the key and on i.
        """
        first = 0
        while num_episodes is None or first < num_episodes:
            numbers = jnp.arange(first, first + self._num_envs)
            keys = jax.vmap(jax.random.fold_in, (None, 0))(key, numbers)
            wanted = self._num_envs if num_episodes is None else min(self._num_envs, num_episodes - first)
            yield from self._batch(parameters, keys, num_steps, wanted)
            first += self._num_envs

    def _batch(self, parameters: Any, keys: jax.Array, num_steps: int, wanted: int) -> Iterator[Episode]:
        if not self._compiled:
            self._compiled = self._compile(parameters, keys)
        reset, advance = self._compiled
        state: State = reset(keys)
        start = _observed(self._environment, state)
        arenas = {
            name: np.asarray(own) for name in ARENA if (own := state.physics.model.get(name)) is not None
        }
        rows: list[dict[str, Any]] = []  # Of several steps each; arrays [steps, envs, ...].
        running = np.ones(wanted, bool)
        taken = 0
        while taken < num_steps and running.any():
            state, observed = advance(parameters, state, keys, jnp.int32(taken))
            rows.append(jax.tree.map(np.asarray, observed))
            running &= ~(rows[-1]["done"][:, :wanted] > 0).any(axis=0)
            taken += _STEPS_PER_CALL
        steps = jax.tree.map(lambda *parts: np.concatenate(parts), *rows)
        metrics = steps.pop("metrics")
        for env in range(wanted):
            own = {name: values[:, env] for name, values in steps.items()}
            begin = {name: np.asarray(values)[env] for name, values in start.items()}
            measured = {name: values[:, env] for name, values in metrics.items()}
            episode = _episode(self._environment, begin, own, measured, num_steps)
            yield replace(episode, arena={name: values[env] for name, values in arenas.items()})

    def _compile(self, parameters: Any, keys: jax.Array) -> Sequence[Callable[..., Any]]:
        """`reset` and `advance`. Left to `jax.jit`, `advance` would be compiled again for the states that it
        returns, if a step's values are weakly typed and a reset's are not."""
        state = jax.eval_shape(self._reset, keys)
        advance = compiling(self._advance.lower(parameters, state, keys, jnp.int32(0)))
        reset = compiling(self._reset.lower(keys))
        return reset.result(), advance.result()


def rollout(
    environment: Environment, policy: Policy, *, key: jax.Array, num_steps: int, num_episodes: int
) -> Trajectory:
    """Episodes of the policy, each until the environment ends it or `num_steps` actions are taken."""
    roller = Roller(
        environment,
        lambda parameters, state, key: policy(state.obs, key),
        num_envs=min(num_episodes, _MAX_ENVS),
    )
    episodes = list(roller.episodes(None, key, num_steps=num_steps, num_episodes=num_episodes))
    return trajectory_of(environment, episodes)


def initial_positions(
    environment: Environment, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """The initial qpos [nq] of the first episode of a rollout job with this seed, and its target, if any."""
    key = jax.random.fold_in(jax.random.PRNGKey(seed), 0)
    state = jax.jit(environment.reset)(key)
    target = _observed(environment, state).get("target")
    return np.asarray(state.physics.qpos, np.float64), None if target is None else np.asarray(target, float)


def footage(
    roller: Roller, parameters: Any, key: jax.Array, *, dt: float, seconds: float, num_at_once: int = 1
) -> list[Episode]:
    """A video of `seconds` shows one episode and, where it ends early, the next ones; or `num_at_once` at the
    same time."""
    most = max(1, round(seconds / dt))
    number = None if num_at_once == 1 else num_at_once
    return filmed(
        roller.episodes(parameters, key, num_steps=most, num_episodes=number),
        dt=dt,
        seconds=seconds,
        num_at_once=num_at_once,
    )


def filmed(episodes: Iterable[Episode], *, dt: float, seconds: float, num_at_once: int = 1) -> list[Episode]:
    """Those of the episodes that a video of `seconds` has time for, cut where it ends; see `footage`."""
    most = max(1, round(seconds / dt))
    if num_at_once > 1:
        return [cut(episode, most) for episode in islice(episodes, num_at_once)]
    chosen: list[Episode] = []
    for episode in episodes:
        chosen.append(cut(episode, most - sum(one.num_steps for one in chosen)))
        if sum(one.num_steps for one in chosen) >= most:
            break
    return chosen


def cut(episode: Episode, num_steps: int) -> Episode:
    """The first `num_steps` steps of an episode; a shorter one is returned unchanged."""
    if episode.num_steps <= num_steps:
        return episode
    states = ("time", "qpos", "qvel", "position", "observation")
    return replace(
        episode,
        **{name: getattr(episode, name)[: num_steps + 1] for name in states},
        **{
            name: values[: num_steps + 1]
            for name in ("target", "command", "velocity", "reference_frame", "reference")
            if (values := getattr(episode, name)) is not None
        },
        action=episode.action[:num_steps],
        reward=episode.reward[:num_steps],
        metrics={name: values[:num_steps] for name, values in episode.metrics.items()},
        terminated=False,
    )


def trajectory_of(environment: Environment, episodes: Sequence[Episode], /, **facts: Any) -> Trajectory:
    """Episodes with a description of their numbers; facts: the environment's id, the seed, the policy."""
    body = str(environment.model.body(environment.tracked_body).name)
    if clips := clips_of(environment):
        facts["clips"] = [asdict(one) for one in clips]
    about = describe(environment.model, dt_s=environment.dt, tracked_body=body, **facts)
    return Trajectory(list(episodes), about)


def _advance(
    environment: Environment,
    policy: ParametricPolicy,
    parameters: Any,
    state: State,
    keys: jax.Array,
    taken: jax.Array,
) -> tuple[State, dict[str, Any]]:
    """`_STEPS_PER_CALL` steps of every environment; returns what is kept of them, [steps, envs, ...].

    The key of step t of an episode depends only on the episode's key and on t.
    """

    action_keys = jax.vmap(jax.random.fold_in, (0, None))(keys, _OF_ACTIONS)

    def step(state: State, number: jax.Array) -> tuple[State, dict[str, Any]]:
        step_keys = jax.vmap(jax.random.fold_in, (0, None))(action_keys, number)
        action = jax.vmap(policy, (None, 0, 0))(parameters, state, step_keys)
        state = jax.vmap(environment.step)(state, action)
        kept = {"action": action, "reward": state.reward, "done": state.done, "metrics": dict(state.metrics)}
        kept["terminated"] = terminated(state)
        return state, kept | _observed(environment, state)

    return jax.lax.scan(step, state, taken + jnp.arange(_STEPS_PER_CALL))


def _observed(environment: Environment, state: State) -> dict[str, jax.Array]:
    obs = state.obs
    if isinstance(obs, Mapping):
        obs = obs[POLICY_GROUP]
    seen = {"qpos": state.physics.qpos, "qvel": state.physics.qvel, "observation": obs}
    recorded = _recorded(environment)
    if TARGET in state.info:
        recorded = {"target": TARGET, **recorded}
    return seen | {name: state.info[entry] for name, entry in recorded.items()}


def _recorded(environment: Environment) -> Mapping[str, str]:
    """`HasCommand.recorded` of the environment, or of the one that it wraps."""
    while isinstance(environment, Wrapped) and not isinstance(environment, HasCommand):
        environment = environment.environment
    return environment.recorded if isinstance(environment, HasCommand) else {}


def _episode(
    environment: Environment,
    begin: Mapping[str, NDArray[np.float32]],
    steps: Mapping[str, NDArray[np.float32]],
    metrics: Mapping[str, NDArray[np.float32]],
    num_steps: int,
) -> Episode:
    """One environment's rows, cut where its episode ends; the steps after that are dropped."""
    ends = np.flatnonzero(steps["done"][:num_steps] > 0)
    length = int(ends[0]) + 1 if len(ends) else num_steps
    states: dict[str, Any] = {
        name: np.concatenate([first[None], steps[name][:length]]) for name, first in begin.items()
    }
    return Episode(
        **states,
        time=np.arange(length + 1, dtype=np.float64) * environment.dt,
        position=_positions(environment, states["qpos"]),
        velocity=_velocities(environment, states["qpos"], states["qvel"]) if "command" in states else None,
        reference=_reference(environment, states["reference_frame"]) if "reference_frame" in states else None,
        action=steps["action"][:length],
        reward=steps["reward"][:length],
        terminated=bool(len(ends)) and bool(steps["terminated"][length - 1]),
        metrics={name: values[:length] for name, values in metrics.items()},
    )


def _positions(environment: Environment, qpos: NDArray[np.float32]) -> NDArray[np.float32]:
    """Where the tracked body is [T+1, 3] in each of the positions [T+1, nq]."""
    data = mujoco.MjData(environment.model)
    positions = np.empty((len(qpos), 3), np.float32)
    for row, values in enumerate(qpos):
        data.qpos[:] = values
        mujoco.mj_kinematics(environment.model, data)
        positions[row] = data.xpos[environment.tracked_body]
    return positions


def _reference(environment: Environment, frames: NDArray[np.int32]) -> NDArray[np.float32] | None:
    inner = innermost(environment)
    return inner.reference_positions(frames) if isinstance(inner, HasClips) else None


def _velocities(
    environment: Environment, qpos: NDArray[np.float32], qvel: NDArray[np.float32]
) -> NDArray[np.float32]:
    """How the tracked body moves in its own frame [T+1, 3]: forward and left in m/s, turn in rad/s."""
    model = environment.model
    data = mujoco.MjData(model)
    turning_and_moving = np.empty(6)
    velocities = np.empty((len(qpos), 3), np.float32)
    for row, (positions, rates) in enumerate(zip(qpos, qvel, strict=True)):
        data.qpos[:], data.qvel[:] = positions, rates
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        body = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(model, data, body, environment.tracked_body, turning_and_moving, 1)
        velocities[row] = turning_and_moving[[3, 4, 2]]
    return velocities
