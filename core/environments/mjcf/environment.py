"""An environment made of a user's own model and of terms."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments import rewards
from core.environments.environment import State
from core.environments.mjcf import binding
from core.environments.mjcf.check import problems
from core.environments.mjcf.describe import height_of, inventory, root_of
from core.environments.mjcf.info import MjcfOptions, metric_names
from core.environments.mjcf.inventory import Inventory
from core.environments.mjcf.model import compiled, read
from core.environments.mjcf.step_context import ModelIndex, StepContext
from core.environments.mjcf.vocabulary import (
    Alive,
    ControlCost,
    ForwardVelocity,
    ObservationTerm,
    OutsideHeightRange,
    Qpos,
    Qvel,
    RewardTerm,
    TerminationTerm,
)
from core.environments.mujoco_env import MujocoEnv, control_range, initial, noisy_start, scaled_to_control
from core.environments.simulation import Noise, Simulation
from core.errors import JobFailed
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, SolverSettings
from core.physics.model import initial_qpos
from core.reasons import Reason

_SECONDS_PER_ACTION = 0.02
_LOWEST, _HIGHEST = 0.4, 2.0


def make(options: MjcfOptions, build_engine: EngineBuilder, model: Path | None = None) -> "Mjcf":
    """The environment under these options. model: the file that holds the model.

    Raises JobFailed("bad_model") if there is none, it does not compile, or the terms do not fit it.
    """
    if model is None:
        raise JobFailed(Reason.BAD_MODEL, f"The file of the model {options.model} is missing.")
    with read(model) as (spec, _):
        original = inventory(compiled(spec))
        if found := problems(options, original):
            raise JobFailed(Reason.BAD_MODEL, " ".join(problem.detail for problem in found))
        stepped = compiled(spec, options.timestep, options.contacts, options.sensors)
        return Mjcf(options, original, spec, stepped, build_engine)


class Mjcf(MujocoEnv):
    """Reward: the weighted sum of the terms. An episode ends when one of the termination terms says so.

    An action of ±1 is an end of a control's range; without a range, the action is the control itself.
    """

    def __init__(
        self,
        options: MjcfOptions,
        parts: Inventory,
        spec: mujoco.MjSpec,
        model: mujoco.MjModel,
        build_engine: EngineBuilder,
    ) -> None:
        root = model.body(options.root).id if options.root else root_of(model)
        named = ModelIndex(model, root)
        paid = options.reward or _default_reward()
        self._names = metric_names(paid)
        self._weights = [term.sign * term.weight for term in paid]
        self._rewards = [binding.reward(term, named) for term in paid]
        seen = options.observation or _default_seen()
        self._seen = [binding.observation(term, named) for term in seen]
        start = _start(model, options)
        height = height_of(model, start, root)
        ends = _default_ends(parts, height) if options.termination is None else options.termination
        self._ends = [binding.termination(term, named) for term in ends]
        where, self._position = named.position(root)
        fields = {field for one in (*self._rewards, *self._seen, *self._ends) for field in one.derived}
        num_substeps = options.n_frames or max(1, round(_SECONDS_PER_ACTION / model.opt.timestep))
        accelerated = SolverSettings(
            options.iterations, options.ls_iterations, implicit_damping=True, solver=options.solver
        )
        engine = build_engine(
            model, num_substeps, tuple(sorted(fields | set(where))), accelerated=accelerated
        )
        super().__init__(model, engine, num_substeps=num_substeps, observation_size=0, tracked_body=root)
        self.initial_qpos = jnp.asarray(start, jnp.float32)
        self.initial_qvel, self.initial_act = _motion(model, options)
        self._spec, self._parts = spec, named
        self._observation, self._termination = seen, ends
        self._reset = options.reset
        self.observation_size = jax.eval_shape(self.reset, jax.random.key(0)).obs.shape[0]

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        physics = noisy_start(
            self,
            key,
            model,
            self._reset.position_noise,
            velocity_scale=self._reset.velocity_noise,
            normal_velocity=self._reset.velocity_distribution == "normal",
        )
        nothing = jnp.zeros(self.action_size)
        context = StepContext(physics, physics, nothing, nothing, self.dt)
        info = {"previous_action": nothing, "start": self._position(physics)}
        return initial(self._after(context, info))

    def step(self, state: State, action: jax.Array) -> State:
        physics = self.engine.step(state.physics, scaled_to_control(self.model, action))
        context = StepContext(state.physics, physics, action, state.info["previous_action"], self.dt)
        return self._after(context, {**state.info, "previous_action": action})

    def simulation(self) -> Simulation:
        reset = self._reset
        return self.simulated(
            self._spec,
            observation=[binding.observed(term, self._parts) for term in self._observation],
            noise=Noise(
                reset.position_noise, reset.velocity_noise, is_normal=reset.velocity_distribution == "normal"
            ),
            ends=[binding.ends(term, self._parts) for term in self._termination],
            control_range=control_range(self.model),
        )

    def _after(self, context: StepContext, info: Mapping[str, jax.Array]) -> State:
        ended = [term.measure(context) for term in self._ends]
        return self.stepped(
            context.after,
            self._observe(context),
            rewards={
                name: weight * term.measure(context)
                for name, weight, term in zip(self._names, self._weights, self._rewards, strict=True)
            },
            done=jnp.max(jnp.stack(ended)) if ended else jnp.zeros(()),
            metrics=self._of_the_body(context, info["start"]),
            info=info,
        )

    def _observe(self, context: StepContext) -> jax.Array:
        return jnp.concatenate([term.measure(context) for term in self._seen])

    def _of_the_body(self, context: StepContext, start: jax.Array) -> dict[str, jax.Array]:
        """The root's position and velocity: m, m/s."""
        position = self._position(context.after)
        velocity = rewards.velocity(self._position(context.before), position, self.dt)
        return {
            "x_position": position[0],
            "y_position": position[1],
            "height": position[2],
            "x_velocity": velocity[0],
            "y_velocity": velocity[1],
            "distance_from_start": rewards.distance(position[:2], start[:2]),
        }


def _default_reward() -> list[RewardTerm]:
    return [ForwardVelocity(), Alive(), ControlCost(weight=0.05)]


def _default_seen() -> list[ObservationTerm]:
    return [Qpos(), Qvel()]


def _default_ends(parts: Inventory, height: float) -> Sequence[TerminationTerm]:
    if not parts.travels or height <= 0:
        return []
    return [OutsideHeightRange(range=(_LOWEST * height, _HIGHEST * height))]


def _start(model: mujoco.MjModel, options: MjcfOptions) -> np.ndarray:
    """Positions [nq] at the start of an episode, before noise."""
    reset = options.reset
    if reset.qpos is not None:
        return np.array(reset.qpos)
    return initial_qpos(model) if reset.keyframe is None else np.array(model.key(reset.keyframe).qpos)


def _motion(model: mujoco.MjModel, options: MjcfOptions) -> tuple[jax.Array | None, jax.Array | None]:
    """The velocities [nv] and the states of actuators [na] of the keyframe; None for those that are 0."""
    if options.reset.keyframe is None:
        return None, None
    key = model.key(options.reset.keyframe)
    qvel, act = (
        jnp.asarray(values, jnp.float32) if np.any(values) else None for values in (key.qvel, key.act)
    )
    return qvel, act
