"""An environment made of a user's own model and of terms."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments.environment import State
from core.environments.mjcf.check import problems
from core.environments.mjcf.describe import height_of, inventory, root_of
from core.environments.mjcf.info import MjcfOptions, metric_names, observed
from core.environments.mjcf.model import compiled, read
from core.environments.mujoco_env import MujocoEnv, control_range, initial, noisy_start, scaled_to_control
from core.environments.numbers import Noise
from core.environments.simulation import Simulation
from core.environments.terms.binding import bound
from core.environments.terms.inventory import Inventory
from core.environments.terms.rewards import Alive, AnyReward, ControlCost, ForwardVelocity
from core.environments.terms.step import ModelIndex, Step
from core.environments.terms.terminations import OutsideHeightRange, TerminationTerm
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
        self._rewards = [bound(term, named) for term in paid]
        seen = observed(options)
        self._seen = [bound(term, named) for term in seen]
        start = _start(model, options)
        height = height_of(model, start, root)
        ends = _default_ends(parts, height) if options.termination is None else options.termination
        self._ends = [bound(term, named) for term in ends]
        where = () if named.free_joint(root) is not None else ("xpos",)
        fields = set(where).union(*(term.derived for term in (*self._rewards, *self._seen, *self._ends)))
        num_substeps = options.n_frames or max(1, round(_SECONDS_PER_ACTION / model.opt.timestep))
        accelerated = SolverSettings(
            options.iterations, options.ls_iterations, implicit_damping=True, solver=options.solver
        )
        engine = build_engine(model, num_substeps, tuple(sorted(fields)), accelerated=accelerated)
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
        step = Step(physics, physics, nothing, nothing, self.dt, jnp)
        info = {"previous_action": nothing, "start": self._parts.position(physics, self.tracked_body)}
        return initial(self._after(step, info))

    def step(self, state: State, action: jax.Array) -> State:
        physics = self.engine.step(state.physics, scaled_to_control(self.model, action))
        step = Step(state.physics, physics, action, state.info["previous_action"], self.dt, jnp)
        return self._after(step, {**state.info, "previous_action": action})

    def simulation(self) -> Simulation:
        reset = self._reset
        return self.simulated(
            self._spec,
            observation=[term.numbers(self._parts) for term in self._observation],
            noise=Noise(
                reset.position_noise, reset.velocity_noise, is_normal=reset.velocity_distribution == "normal"
            ),
            ends=[term.ends(self._parts) for term in self._termination],
            control_range=control_range(self.model),
        )

    def _after(self, step: Step, info: Mapping[str, jax.Array]) -> State:
        ended = [term.measure(step) for term in self._ends]
        return self.stepped(
            step.after,
            self._observe(step),
            rewards={
                name: weight * term.measure(step)
                for name, weight, term in zip(self._names, self._weights, self._rewards, strict=True)
            },
            done=jnp.max(jnp.stack(ended)) if ended else jnp.zeros(()),
            metrics=self._of_the_body(step, info["start"]),
            info=info,
        )

    def _observe(self, step: Step) -> jax.Array:
        return jnp.concatenate([term.measure(step) for term in self._seen])

    def _of_the_body(self, step: Step, start: jax.Array) -> dict[str, jax.Array]:
        """The root's position and velocity: m, m/s."""
        position = self._parts.position(step.after, self.tracked_body)
        velocity = self._parts.velocity(step, self.tracked_body)
        return {
            "x_position": position[0],
            "y_position": position[1],
            "height": position[2],
            "x_velocity": velocity[0],
            "y_velocity": velocity[1],
            "distance_from_start": jnp.linalg.norm(position[:2] - start[:2]),
        }


def _default_reward() -> list[AnyReward]:
    return [ForwardVelocity(), Alive(), ControlCost(weight=0.05)]


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
