"""A walker that learns to run down a corridor. Rewards as in the tutorial notebook."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from types import MappingProxyType

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments.dm_control.corridor import egocentric, rewards, termination
from core.environments.dm_control.corridor.as_rodent import AsRodent
from core.environments.dm_control.corridor.curriculum import at_every_level
from core.environments.dm_control.corridor.info import SIGHT_M, CorridorOptions, spaces
from core.environments.dm_control.corridor.layouts import ManyCourses, OneCourse
from core.environments.dm_control.corridor.model import boxes, corridor_spec, model_and_layouts, obstacles
from core.environments.dm_control.corridor.options import in_order, values
from core.environments.dm_control.corridor.walkers import WALKERS
from core.environments.environment import State
from core.environments.mujoco_env import MujocoEnv, initial, noisy_start
from core.environments.simulated_model import NotSimulated
from core.environments.simulation import Simulation, simulation_of
from core.environments.terms.lent import seen_by
from core.environments.terms.observations import ObservationTerm
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState, SolverSettings


def holding_controls(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """The controls [nu] in [-1, 1] under which no actuator exerts a force at rest in the positions qpos [nq].

    Those of torques are 0. Source: MuJoCo's actuation model, force = gain · control + bias, where a position
    servo's bias is b0 + b1 · length.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    bias = model.actuator_biasprm[:, 0] + model.actuator_biasprm[:, 1] * data.actuator_length
    return np.clip(-bias / model.actuator_gainprm[:, 0], -1.0, 1.0).astype(np.float32)


_DERIVED = ("subtree_com", "xpos")
# The top of the ground; a trunk below it is in a gap.
_GROUND_M = 0.0


def make(options: CorridorOptions, build_engine: EngineBuilder) -> "Corridor":
    """The corridor under these options, moved by the engine that `build_engine` makes."""
    return Corridor(options, build_engine)


class Corridor(MujocoEnv):
    """Reward: forward speed + distance + being up - the action's cost.

    An episode ends when the trunk falls into a gap or leaves the healthy range.
    """

    # The notebook reports the term under both names, as Brax's humanoid does.
    aliases: Mapping[str, str] = MappingProxyType({"reward_linvel": "forward_reward"})

    def __init__(self, options: CorridorOptions, build_engine: EngineBuilder) -> None:
        model, layouts = model_and_layouts(options)
        accelerated = SolverSettings.of_job(
            options.iterations, options.ls_iterations, implicit_damping=True, solver=options.solver
        )
        walker = WALKERS[options.walker]
        dt, trunk = options.timestep * options.n_frames, model.body(walker.trunk).id
        decoder_sees = seen_by(options.action)
        self._for_decoder = AsRodent(decoder_sees, model, trunk, dt) if decoder_sees else None
        read = (
            *_DERIVED,
            *in_order(options.observables),
            *(egocentric.DERIVED if options.egocentric_depth else ()),
            *termination.derived_fields(options),
            *(sorted(self._for_decoder.derived) if self._for_decoder else ()),
        )
        hidden = 2 if options.exclude_current_positions_from_observation else 0
        super().__init__(
            model,
            build_engine(model, options.n_frames, tuple(dict.fromkeys(read)), accelerated=accelerated),
            num_substeps=options.n_frames,
            observation_size=spaces(options).observation_size,
            tracked_body=trunk,
        )
        self.episode_length = options.episode_length
        self._held = (
            holding_controls(model, np.asarray(self.initial_qpos)) if options.counts_from_start else None
        )
        # Noise must not push it into the ground, which would throw it up.
        self.initial_qpos = self.initial_qpos.at[2].add(options.reset_noise_scale)
        self._options = options
        self._num_hidden = hidden
        self._bodies = slice(self.tracked_body, None)  # The walker comes after its arena.
        self._endings = termination.Endings(model, options)
        ends = options.start_x, options.corridor_length
        self._course = (
            ManyCourses(layouts, model, *ends)
            if layouts
            else OneCourse(boxes(model), obstacles(model), *ends)
        )
        side = options.egocentric_depth
        self._camera = egocentric.EgocentricDepth(model, side) if side else None
        self._target_velocities = _target_velocities(options)
        self._progress: jax.Array | float = 1.0

    @property
    def curriculum_steps(self) -> int | None:
        curriculum = self._options.curriculum
        return None if curriculum is None else curriculum.over_steps

    def at_progress(self, progress: jax.Array) -> "Corridor":
        later = copy.copy(self)
        later._progress = progress
        return later

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        layout, info = self._course.draw(key, self._progress)
        own = {**layout, **model}
        physics = noisy_start(self, key, own, self._options.reset_noise_scale, normal_velocity=False)
        if self._held is not None:
            # A servo with a filter begins where its control will be, or it would pull at the first steps.
            physics = replace(
                physics,
                act=jnp.asarray(self._held[self.model.actuator_actadr >= 0]),
                derived=_without_forces(physics.derived),
            )
        return initial(self._after(physics, physics, jnp.zeros(self.action_size), info))

    def step(self, state: State, action: jax.Array) -> State:
        physics = self.engine.step(state.physics, self._control(action))
        return self._after(state.physics, physics, action, state.info)

    def places_of(self, terms: Sequence[ObservationTerm]) -> np.ndarray:
        """Where the numbers of the terms that its decoder sees are in the observation."""
        del terms
        size = self._for_decoder.size if self._for_decoder else 0
        return np.arange(size) + spaces(self._options).observation_size - size

    def simulation(self) -> Simulation:
        if self._options.has_layouts:
            raise NotSimulated("each episode has another corridor")
        return simulation_of(self, corridor_spec(self._options))

    def _control(self, action: jax.Array) -> jax.Array:
        """The control [nu] for an action [nu], both in [-1, 1]."""
        return action if self._held is None else jnp.clip(self._held + action, -1.0, 1.0)

    def _after(
        self, before: PhysicsState, physics: PhysicsState, action: jax.Array, info: Mapping[str, jax.Array]
    ) -> State:
        options = self._options
        old, new = self._centre_of_mass(before), self._centre_of_mass(physics)
        velocity = (new - old) / self.dt
        height = physics.derived["xpos"][self.tracked_body, 2]
        healthy = rewards.height_range(height, options.healthy_range)
        survives, ended = rewards.survival(healthy, terminates=options.terminate_when_unhealthy)
        way_before, way_after = (self._course.passed(info, where[0]) for where in (old, new))
        fell = jnp.where(height < _GROUND_M, 1.0, 0.0)
        endings = self._endings(physics)
        seen = self._observe(physics, info)
        if self._for_decoder is not None:
            by_decoder, remembered = self._for_decoder(before, physics, action, info)
            seen, info = jnp.concatenate([seen, by_decoder]), {**info, **remembered}
        return self.stepped(
            physics,
            seen,
            rewards={
                "forward_reward": options.forward_reward_weight * velocity[0],
                "distance_reward": options.distance_reward_weight * velocity[0] * self.dt,
                "reward_alive": options.healthy_reward * survives,
                "reward_quadctrl": -options.ctrl_cost_weight * jnp.sum(jnp.square(action)),
                **self._target_velocity_reward(velocity[0], info),
            },
            done=reduce(jnp.maximum, endings.values(), jnp.maximum(fell, ended)),
            metrics={
                "height": height,
                "x_position": new[0],
                "y_position": new[1],
                "distance_from_origin": jnp.linalg.norm(new),
                "x_velocity": velocity[0],
                "y_velocity": velocity[1],
                "obstacles_passed": self._num_behind(info, new[0]) - self._num_behind(info, old[0]),
                "way_passed": way_after - way_before,
                "success": jnp.floor(way_after) - jnp.floor(way_before),
                "fell": jnp.maximum(fell, 1.0 - healthy),
                **endings,
            },
            info=info,
        )

    def _target_velocity_reward(
        self, speed: jax.Array, info: Mapping[str, jax.Array]
    ) -> Mapping[str, jax.Array]:
        """dm_control's reward for a speed [] in +x, where the options ask for it."""
        if self._target_velocities is None:
            return {}
        target = self._target_velocities[self._course.level(info)]
        worth = rewards.linear_tolerance(speed, target, margin=target)
        return {"reward_target_velocity": self._options.target_velocity_weight * worth}

    def _centre_of_mass(self, physics: PhysicsState) -> jax.Array:
        """[3], in metres, of the trunk's subtree: the walker, without the arena."""
        return physics.derived["subtree_com"][self.tracked_body]

    def _num_behind(self, info: Mapping[str, jax.Array], x: jax.Array) -> jax.Array:
        """How many gaps or walls [] end behind x."""
        return jnp.sum(x > self._course.obstacles(info)[:, 1], dtype=jnp.float32)

    def _observe(self, physics: PhysicsState, info: Mapping[str, jax.Array]) -> jax.Array:
        seen = self._ahead(info, physics.qpos[:2], self._options.num_next_obstacles)
        fields = values(self._options.observables, physics, self._bodies)
        image = [] if self._camera is None else [self._camera(physics, self._course.boxes(info))]
        return jnp.concatenate([physics.qpos[self._num_hidden :], physics.qvel, *fields, seen, *image])

    def _ahead(self, info: Mapping[str, jax.Array], at: jax.Array, number: int) -> jax.Array:
        """[3 number]: for each next gap or wall, how far ahead of `at` [x, y] it begins and ends, and how far
        to the left the middle of the way past it is. Distances are capped at SIGHT_M."""
        nothing = jnp.tile(jnp.array([jnp.inf, jnp.inf, 0.0]), (number, 1))
        first = self._num_behind(info, at[0]).astype(jnp.int32)
        known = jnp.concatenate([self._course.obstacles(info), nothing])
        rows = jax.lax.dynamic_slice(known, (first, 0), (number, 3))
        ahead = jnp.minimum(rows[:, :2] - at[0], SIGHT_M)
        left = jnp.where(ahead[:, :1] < SIGHT_M, rows[:, 2:] - at[1], 0.0)
        return jnp.concatenate([ahead, left], axis=1).ravel()


def _without_forces(derived: Mapping[str, jax.Array]) -> Mapping[str, jax.Array]:
    """With no force of an actuator, as nothing pulls yet; the engine took the filters to be at 0."""
    name = "qfrc_actuator"
    return {**derived, name: jnp.zeros_like(derived[name])} if name in derived else derived


def _target_velocities(options: CorridorOptions) -> jax.Array | None:
    """In m/s, by the level of the curriculum; None if the reward has no such term."""
    if options.target_velocity is None:
        return None
    levels = at_every_level(options, options.curriculum)
    return jnp.array([one.target_velocity for one in levels], jnp.float32)
