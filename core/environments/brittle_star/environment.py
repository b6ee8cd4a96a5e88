"""Brittle stars that learn to move. Source: biorobot's environments; our engines compute the physics."""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import mujoco

from core.environments.action_to_control import scaled_to_control
from core.environments.brittle_star.model import star_model
from core.environments.brittle_star.options import (
    BODY_OBSERVABLES,
    DISK,
    BodyObservable,
    DirectedOptions,
    LightEscapeOptions,
    Options,
    UndirectedOptions,
    observed,
)
from core.environments.brittle_star.tasks import (
    Directed,
    LightEscape,
    StarTask,
    TaskMeasurement,
    Undirected,
    show,
)
from core.environments.cpg.actions import steered_by_oscillators
from core.environments.environment import Discretization, Environment, Seen, State, StateDiscretizer
from core.environments.mujoco_env import MujocoEnv, initial
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState, SolverSettings


def controlled(star: Environment, options: Options) -> Environment:
    """The star under `options.control`; unchanged if actions are the joints' own."""
    match options.control:
        case "joints":
            return star
        case "cpg":
            return steered_by_oscillators(star, options.num_arms, options.cpg)


# Coordinates of the disk in qpos and qvel; the joints' follow, arm by arm and outwards.
NUM_ROOT_POSITIONS, NUM_ROOT_VELOCITIES = 7, 6


def observe_body(physics: PhysicsState, name: BodyObservable) -> jax.Array:
    """The observable [n]; joints come in pairs, in the disk's plane and out of it.

    The disk's velocities are along the world's axes. Every joint has one motor and no gear, so the motor's
    force is the joint's. Contacts are normal forces summed over a segment, in N; they and the motors' forces
    are those of the last physics step.
    """
    match name:
        case "joint_position":
            return physics.qpos[NUM_ROOT_POSITIONS:]
        case "joint_velocity":
            return physics.qvel[NUM_ROOT_VELOCITIES:]
        case "joint_actuator_force" | "actuator_force":
            return physics.derived["qfrc_actuator"][NUM_ROOT_VELOCITIES:]
        case "disk_position":
            return physics.qpos[:3]
        case "disk_rotation":
            return roll_pitch_yaw(physics.qpos[3:7])
        case "disk_linear_velocity":
            return physics.qvel[:3]
        case "disk_angular_velocity":
            return rotated(physics.qpos[3:7], physics.qvel[3:6])
        case "segment_contact":
            return physics.derived["sensordata"]


def roll_pitch_yaw(quaternion: jax.Array) -> jax.Array:
    """Angles [3] in rad about the fixed axes x, then y, then z, of a unit quaternion w x y z [4]."""
    w, x, y, z = quaternion
    roll = jnp.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = jnp.arcsin(jnp.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return jnp.stack([roll, pitch, yaw])


def rotated(quaternion: jax.Array, vector: jax.Array) -> jax.Array:
    """The vector [3] of the body's frame in the world's, by a unit quaternion w x y z [4]."""
    w, axis = quaternion[0], quaternion[1:]
    twice = 2 * jnp.cross(axis, vector)
    return vector + w * twice + jnp.cross(axis, twice)


def about_the_vertical(angle: jax.Array) -> jax.Array:
    """The quaternion w x y z [4] of a rotation by `angle` [] in rad."""
    zero = jnp.zeros(())
    return jnp.stack([jnp.cos(angle / 2), zero, zero, jnp.sin(angle / 2)])


def directed(options: DirectedOptions, build_engine: EngineBuilder) -> Environment:
    """Locomotion towards a target, moved by the engine that `build_engine` makes."""
    return controlled(BrittleStar(options, star_model(options), Directed(options), build_engine), options)


def undirected(options: UndirectedOptions, build_engine: EngineBuilder) -> Environment:
    """Locomotion away from the start, moved by the engine that `build_engine` makes."""
    return controlled(BrittleStar(options, star_model(options), Undirected(), build_engine), options)


def light_escape(options: LightEscapeOptions, build_engine: EngineBuilder) -> Environment:
    """Locomotion out of the light, moved by the engine that `build_engine` makes."""
    model = star_model(options)
    task = LightEscape(options, model)
    show(model, task.light_map)
    return controlled(BrittleStar(options, model, task, build_engine), options)


class BrittleStar(MujocoEnv):
    """Reward: the growth of the task's potential. An episode ends when the task is done.

    In every state, `info` has `disk_position` [3] in the world, in metres; `disk_rotation` [3], roll, pitch
    and yaw in rad; and what the task adds. An action of ±1 is an end of the joints' ranges, or of the
    torques'.
    """

    # There is one term, which is the reward itself.
    reports_rewards = False

    def __init__(
        self, options: Options, model: mujoco.MjModel, task: StarTask, build_engine: EngineBuilder
    ) -> None:
        self._observed = observed(options)
        accelerated = SolverSettings.of_job(options.iterations, options.ls_iterations, implicit_damping=False)
        num_substeps = options.num_physics_steps_per_control_step
        derived = (*_derived(self._observed), *task.derived)
        super().__init__(
            model,
            build_engine(model, num_substeps, derived, accelerated=accelerated),
            num_substeps=num_substeps,
            observation_size=0,
            tracked_body=DISK,
        )
        if isinstance(options, DirectedOptions):
            self.discretization = towards_target(options.num_arms)
        self.episode_length = options.episode_length
        self._options, self._task = options, task
        self.observation_size = jax.eval_shape(self.reset, jax.random.key(0)).obs.shape[0]

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        key_task, key_rotation, key_position, key_velocity = jax.random.split(key, 4)
        scale = self._options.joint_randomization_noise_scale
        joints = (self.action_size,)
        position = jax.random.uniform(key_position, joints, minval=-scale, maxval=scale)
        velocity = jax.random.uniform(key_velocity, joints, minval=-scale, maxval=scale)
        qpos = self.initial_qpos.at[NUM_ROOT_POSITIONS:].add(position)
        if self._options.random_initial_rotation:
            angle = jax.random.uniform(key_rotation, minval=-jnp.pi, maxval=jnp.pi)
            qpos = qpos.at[3:7].set(about_the_vertical(angle))
        qvel = jnp.concatenate([jnp.zeros(NUM_ROOT_VELOCITIES), velocity])
        physics = self.engine.reset(qpos, qvel, model)
        return initial(self._after(physics, physics, self._task.draw(key_task)))

    def step(self, state: State, action: jax.Array) -> State:
        physics = self.engine.step(state.physics, scaled_to_control(self.model, action))
        return self._after(state.physics, physics, state.info)

    def _after(self, before: PhysicsState, physics: PhysicsState, info: Mapping[str, jax.Array]) -> State:
        old, new = self._task.measure(before, info), self._task.measure(physics, info)
        return self.stepped(
            physics,
            self._observe(physics, new),
            rewards={"reward_progress": new.potential - old.potential},
            done=new.done,
            metrics=self._metrics(before, physics, new),
            info=_info(physics, info, new),
        )

    def _observe(self, physics: PhysicsState, measured: TaskMeasurement) -> jax.Array:
        """The observables of the options, in biorobot's order."""
        of_the_body = {
            name: observe_body(physics, name) for name in BODY_OBSERVABLES if name in self._observed
        }
        every = {**of_the_body, **measured.observables}
        return jnp.concatenate([every[name] for name in self._observed])

    def _metrics(
        self, before: PhysicsState, after: PhysicsState, measured: TaskMeasurement
    ) -> dict[str, jax.Array]:
        """The disk's position and velocity: m, m/s."""
        x, y, height = after.qpos[:3]
        velocity = (after.qpos - before.qpos)[:2] / self.dt
        return {
            "x_position": x,
            "y_position": y,
            "height": height,
            "x_velocity": velocity[0],
            "y_velocity": velocity[1],
            "distance_from_origin": jnp.linalg.norm(after.qpos[:2]),
            **measured.metrics,
        }


def _derived(observed: Sequence[str]) -> tuple[str, ...]:
    """The fields that engines compute for these observables."""
    forces = not {"joint_actuator_force", "actuator_force"}.isdisjoint(observed)
    contacts = "segment_contact" in observed
    return (*(("qfrc_actuator",) if forces else ()), *(("sensordata",) if contacts else ()))


def _info(
    physics: PhysicsState, info: Mapping[str, jax.Array], measured: TaskMeasurement
) -> dict[str, jax.Array]:
    return {
        **info,
        **measured.info,
        "disk_position": physics.qpos[:3],
        "disk_rotation": roll_pitch_yaw(physics.qpos[3:7]),
    }


_NEEDS = ("disk_rotation", "xy_direction_to_target")


def towards_target(num_arms: int) -> Discretization:
    """arm_towards_target: one row, the arm in whose sector the target lies. arm_role, arm_side: a row for
    each arm."""
    arms = tuple(f"target: arm {arm}" for arm in range(num_arms))
    steps = ("target: this arm", *(f"target: {number} to the left" for number in range(1, num_arms)))
    sides = ("closest to the target", "on the left", "on the right", "opposite")[: num_sides(num_arms)]
    return Discretization(
        {
            "arm_towards_target": StateDiscretizer(
                _NEEDS, num_arms, 1, lambda seen: sector_of_target(seen, num_arms)[None], arms
            ),
            "arm_role": StateDiscretizer(
                _NEEDS, num_arms, num_arms, lambda seen: steps_to_target(seen, num_arms), steps
            ),
            "arm_side": StateDiscretizer(
                _NEEDS, len(sides), num_arms, lambda seen: sides_of_target(seen, num_arms), sides
            ),
        }
    )


def sector_of_target(seen: Seen, num_arms: int) -> jax.Array:
    """[] int32: the arm in whose sector the target lies.

    Arm k points at 2π k / num_arms from the disk's x axis, and its sector reaches π / num_arms to both sides;
    the clockwise edge belongs to it. Source: the tutorial notebook's direction bins, with the angle wrapped.
    """
    direction = seen["xy_direction_to_target"]
    angle = jnp.arctan2(direction[1], direction[0]) - seen["disk_rotation"][2]
    sectors = jnp.floor(angle * num_arms / (2 * jnp.pi) + 0.5)
    return jnp.mod(sectors, num_arms).astype(jnp.int32)


def steps_to_target(seen: Seen, num_arms: int) -> jax.Array:
    """[num_arms] int32: how many arms each lies clockwise of the one that faces the target."""
    return jnp.mod(sector_of_target(seen, num_arms) - jnp.arange(num_arms), num_arms).astype(jnp.int32)


def num_sides(num_arms: int) -> int:
    """How many sides of the target an arm may be on: in a star of an even number, one may be opposite."""
    return 3 + (num_arms % 2 == 0)


def sides_of_target(seen: Seen, num_arms: int) -> jax.Array:
    """[num_arms] int32: where each arm is, looking towards the target: 0 closest to it, 1 on the left, 2 on
    the right, 3 opposite. Source: the tutorial notebook's exercise, whose stars have five arms."""
    steps = steps_to_target(seen, num_arms)
    # An arm from which the target lies a few arms on, counter-clockwise, is on the right of it.
    side = jnp.where(2 * steps < num_arms, 2, jnp.where(2 * steps > num_arms, 1, 3))
    return jnp.where(steps == 0, 0, side).astype(jnp.int32)
