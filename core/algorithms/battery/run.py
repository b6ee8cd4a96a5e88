"""A battery: a policy's episodes under eight commands, in C MuJoCo at the model's own solver, on the CPU."""

import math
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.algorithms.battery.result import SMOOTHNESS, BatteryResult, CommandResult, Quantity, judged
from core.algorithms.battery.spec import (
    SETTLING_S,
    STRAIGHT_ON,
    TOLERANCE,
    BatterySpec,
    Command,
    battery_options,
    clipped,
    commands_within,
)
from core.algorithms.trained_policy import TrainedPolicy
from core.compilation import compiling
from core.environments.environment import State, Wrapped
from core.environments.task import TaskEnv
from core.environments.terms.actions import ActionTerm, JointAction
from core.environments.terms.actuation import actuation
from core.environments.terms.commands import VelocityCommand
from core.environments.terms.task import TaskOptions
from core.patterns import matching_in_turn
from core.physics.engine import NOMINAL, ModelFields

# Actions between two looks at whether the battery is to end.
_STEPS_PER_CALL = 50

_TRACKING = ("linear_tracking", "angular_tracking")

Make = Callable[[TaskOptions], TaskEnv]
# A state, the action before it, and sums by name.
_Running = tuple[State, jax.Array, dict[str, jax.Array]]


def on_the_cpu() -> AbstractContextManager[Any]:
    """Inside the block JAX computes on the CPU, also where it has a GPU, which C MuJoCo cannot use."""
    try:
        return jax.default_device(jax.local_devices(backend="cpu")[0])
    except RuntimeError:  # JAX was told to use nothing but the GPU.
        return nullcontext()


def run_battery(
    make: Make,
    options: TaskOptions,
    policy: TrainedPolicy,
    spec: BatterySpec,
    *,
    seed: int,
    is_stopped: Callable[[], bool] = lambda: False,
) -> BatteryResult | None:
    """The result of one policy; see `Battery`."""
    return Battery(make, options, policy, spec).run(policy.parameters, seed=seed, is_stopped=is_stopped)


class Battery:
    """A battery, compiled for the policies of a training: they differ by their parameters alone.

    make: the task under options, on the engine `native`; it is called where JAX computes on the CPU. options:
    of the task as it was trained. policy: one of the policies. Raises ValueError if the task has no velocity
    command, and JobFailed as `make`.
    """

    def __init__(self, make: Make, options: TaskOptions, policy: TrainedPolicy, spec: BatterySpec) -> None:
        if not isinstance(options.command, VelocityCommand):
            raise ValueError("The task has no velocity command.")
        self._spec, self._trained = spec, options.command
        self._commands = commands_within(self._trained)
        with on_the_cpu():
            environment = make(battery_options(options, spec))
            self._legs = leg_joints(environment.model, environment.tracked_body, options.feet)
            self._settled, self._end = (round(s / environment.dt) for s in (SETTLING_S, spec.seconds))
            meter = _Meter(environment, self._legs, *_acted_on(options, environment.model))
            episodes = _Episodes(environment, policy, meter, self._settled, self._end)
            begin, advance = jax.jit(jax.vmap(episodes.begin)), jax.jit(episodes.advance)
            running = jax.eval_shape(begin, *self._starts(0))
            advancing = compiling(advance.lower(policy.parameters, running, jnp.int32(0)))
            self._begin = compiling(begin.lower(*self._starts(0))).result()
            self._advance = advancing.result()
        self._model = environment.model

    def run(
        self, parameters: Any, *, seed: int, is_stopped: Callable[[], bool] = lambda: False
    ) -> BatteryResult | None:
        """The result of the policy with these parameters; None if it was stopped."""
        began = time.perf_counter()
        with on_the_cpu():
            running = self._begin(*self._starts(seed))
            for first in range(0, self._end, _STEPS_PER_CALL):
                if is_stopped():
                    return None
                running = jax.block_until_ready(self._advance(parameters, running, jnp.int32(first)))
        shape = len(self._commands), self._spec.starts
        sums = {name: np.asarray(values).reshape(shape) for name, values in running[2].items()}
        rows = [
            _row(command, {name: values[number] for name, values in sums.items()}, self._end - self._settled)
            for number, command in enumerate(self._commands)
        ]
        passed, criteria = judged(rows, clipped(STRAIGHT_ON, self._trained), self._spec.bounds)
        return BatteryResult(
            passed=passed,
            criteria=criteria,
            commands=rows,
            spec=self._spec,
            seed=seed,
            engine="native",
            legs=[self._model.joint(joint).name for joint in self._legs],
            took_s=time.perf_counter() - began,
        )

    def _starts(self, seed: int) -> tuple[jax.Array, jax.Array]:
        """The key and the command [3] of each episode; each command has the same starts."""
        starts, commands = self._spec.starts, self._commands
        keys = jnp.tile(jax.random.split(jax.random.key(seed), starts), len(commands))
        return keys, jnp.repeat(jnp.array(commands, jnp.float32), starts, axis=0)


def leg_joints(model: mujoco.MjModel, root: int, feet: list[str]) -> list[int]:
    """Numbers of the hinges and slides with actuators between the root and a foot; without feet, of all.

    root: the body's number. feet: patterns of bodies' names.
    """
    on_a_joint = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
    driven = sorted({int(joint) for joint in model.actuator_trnid[on_a_joint, 0]})
    if not feet:
        return driven
    bodies = set[int]()
    for name in matching_in_turn(feet, [model.body(number).name for number in range(1, model.nbody)]):
        body = int(model.body(name).id)
        while body not in (0, root):
            bodies.add(body)
            body = int(model.body_parentid[body])
    return [joint for joint in driven if int(model.jnt_bodyid[joint]) in bodies]


def _acted_on(options: TaskOptions, model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """The actuators [actions] of a policy's actions, and how far an action of 1 moves each one's target."""
    if isinstance(options.action, JointAction):
        found = actuation(options.action, model, model.qpos0)
        is_target = np.array([kind == "position" for kind in found.kinds])
        return found.actuators, np.where(is_target, found.gain, np.nan)[found.actuators]
    if isinstance(options.action, ActionTerm):
        return np.array([], int), np.array([])
    return np.arange(model.nu), np.full(model.nu, np.nan)


@dataclass(frozen=True)
class _Commanded(Wrapped):
    """Episodes have this command [3], which may be traced, from their reset on."""

    environment: TaskEnv
    command: jax.Array

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        return self.environment.reset(key, model, command=self.command)

    def step(self, state: State, action: jax.Array) -> State:
        return self.environment.step(state, action)


@dataclass(frozen=True)
class _Meter:
    """Measures the steps of one episode. legs: numbers of the joints. actuators: [actions], those that are
    acted on. scale: [actions], what an action of 1 adds to a servo's target; NaN where it has none."""

    environment: TaskEnv
    legs: list[int]
    actuators: np.ndarray
    scale: np.ndarray

    def zeros(self) -> dict[str, jax.Array]:
        """fell: 1 if it did. steps: those counted. The others are sums over these."""
        return dict.fromkeys(("fell", "steps", *_TRACKING, *SMOOTHNESS), jnp.zeros(()))

    def measure(self, state: State, action: jax.Array, previous: jax.Array) -> dict[str, jax.Array]:
        """A step's quantities, [] each; those of smoothness are squares, means over the joints."""
        model, qvel = self.environment.model, state.physics.qvel
        root = int(model.jnt_dofadr[model.body_jntadr[self.environment.tracked_body]])
        of_legs = np.flatnonzero(np.isin(model.actuator_trnid[self.actuators, 0], self.legs))
        change = (action - previous)[of_legs]
        scale = self.scale[of_legs]
        return {
            "steps": jnp.ones(()),
            "linear_tracking": jnp.exp(-((state.metrics["velocity_error"] / TOLERANCE) ** 2)),
            "angular_tracking": jnp.exp(-((state.metrics["turn_error"] / TOLERANCE) ** 2)),
            "action_change": jnp.mean(change**2),
            "target_change": jnp.mean((scale * change) ** 2),
            "torso_rate": jnp.sum(qvel[root + 3 : root + 5] ** 2),
            "yaw_rate": qvel[root + 5] ** 2,
            "leg_velocity": jnp.mean(qvel[model.jnt_dofadr[self.legs]] ** 2),
        }


@dataclass(frozen=True)
class _Episodes:
    """All episodes of all commands side by side. settled, end: actions, from and until which are counted."""

    environment: TaskEnv
    policy: TrainedPolicy
    meter: _Meter
    settled: int
    end: int

    def begin(self, key: jax.Array, command: jax.Array) -> _Running:
        """One episode under the command [3]."""
        environment, _ = self.policy.acting(_Commanded(self.environment, command))
        return environment.reset(key), jnp.zeros(self.environment.action_size), self.meter.zeros()

    def advance(self, parameters: Any, running: _Running, first: jax.Array) -> _Running:
        """`_STEPS_PER_CALL` actions of each of [N] episodes, of which the first is number `first`."""

        def step(running: _Running, number: jax.Array) -> tuple[_Running, None]:
            return jax.vmap(self._step, (None, 0, None))(parameters, running, number), None

        return jax.lax.scan(step, running, first + jnp.arange(_STEPS_PER_CALL))[0]

    def _step(self, parameters: Any, running: _Running, number: jax.Array) -> _Running:
        before, previous, sums = running
        environment, act = self.policy.acting(self.environment)
        action = act(parameters, before, jax.random.key(0))  # The policy is deterministic.
        state = environment.step(before, action)
        is_lost = ~jnp.all(jnp.isfinite(state.physics.qpos)) | ~jnp.all(jnp.isfinite(state.physics.qvel))
        falls = ((state.done > 0) | is_lost) & (number < self.end)
        fell = jnp.maximum(sums["fell"], falls.astype(jnp.float32))
        counts = (number >= self.settled) & (number < self.end) & (fell == 0)
        now = self.meter.measure(state, action, previous)
        added = {name: sums[name] + jnp.where(counts, value, 0.0) for name, value in now.items()}
        return state, action, {"fell": fell, **added}


def _row(command: Command, sums: Mapping[str, np.ndarray], num_counted: int) -> CommandResult:
    """sums: [starts]. num_counted: actions that are counted of an episode without a fall."""
    total = {name: float(np.sum(values, dtype=np.float64)) for name, values in sums.items()}
    starts, steps = len(sums["fell"]), total["steps"]

    def rms(name: Quantity) -> float | None:
        return math.sqrt(total[name] / steps) if steps and math.isfinite(total[name]) else None

    return CommandResult(
        command=command,
        episodes=starts,
        falls=round(total["fell"]),
        linear_tracking=total["linear_tracking"] / (starts * num_counted),
        angular_tracking=total["angular_tracking"] / (starts * num_counted),
        action_change=rms("action_change"),
        target_change=rms("target_change"),
        torso_rate=rms("torso_rate"),
        yaw_rate=rms("yaw_rate"),
        leg_velocity=rms("leg_velocity"),
    )
