"""From a job's terms to functions of a step: each term is bound to its parts' places in the arrays."""

from dataclasses import replace
from typing import Literal, assert_never

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments import rewards
from core.environments.mjcf.model import is_ours, sensor_name
from core.environments.mjcf.step_context import BoundTerm, ModelIndex, StepContext
from core.environments.mjcf.vocabulary import (
    ActionRate,
    Activation,
    ActuatorForces,
    Alive,
    BodyOrientations,
    BodyPositions,
    Cinert,
    Contact,
    ControlCost,
    Cvel,
    Distance,
    Energy,
    ForwardVelocity,
    HeightRange,
    JointLimits,
    NotUpright,
    ObservationTerm,
    OutsideHeightRange,
    PreviousAction,
    Qpos,
    Qvel,
    RewardTerm,
    Sensors,
    TerminationTerm,
    Touching,
    Upright,
    VelocityTracking,
)
from core.environments.simulation import PREVIOUS_ACTION, Ends, NotSimulated, Numbers, numbers, rows


def reward(term: RewardTerm, parts: ModelIndex) -> BoundTerm:  # noqa: C901 # A table.
    """The term's value in a step, [], before its weight and sign."""
    match term:
        case ForwardVelocity():
            return _forward_velocity(term, parts)
        case VelocityTracking():
            return _velocity_tracking(term, parts)
        case Upright():
            return _upright(term, parts)
        case HeightRange():
            return _in_height_range(term, parts)
        case Alive():
            return BoundTerm((), lambda context: jnp.ones(()))
        case ControlCost():
            return BoundTerm((), lambda context: rewards.control_cost(context.action))
        case Energy():
            return BoundTerm(
                ("qfrc_actuator",),
                lambda context: rewards.energy(context.after.derived["qfrc_actuator"], context.after.qvel),
            )
        case ActionRate():
            return BoundTerm((), lambda context: rewards.action_rate(context.action, context.previous_action))
        case Distance():
            return _distance(term, parts)
        case JointLimits():
            return _joint_limits(term, parts)
        case Contact():
            return _num_touching(term, parts)
        case _:
            assert_never(term)


def termination(term: TerminationTerm, parts: ModelIndex) -> BoundTerm:
    """1 where the term ends the episode, otherwise 0; []."""
    match term:
        case OutsideHeightRange():
            inside = _in_height_range(term, parts)
            return BoundTerm(inside.derived, lambda context: 1.0 - inside.measure(context))
        case NotUpright(least=least):
            cosine = _upright(term, parts)
            return BoundTerm(
                cosine.derived, lambda context: jnp.where(cosine.measure(context) < least, 1.0, 0.0)
            )
        case Touching():
            number = _num_touching(term, parts)
            return BoundTerm(number.derived, lambda context: jnp.where(number.measure(context) > 0, 1.0, 0.0))
        case _:
            assert_never(term)


def observation(term: ObservationTerm, parts: ModelIndex) -> BoundTerm:
    """The term's observation after a step, [n]."""
    seen = observed(term, parts)
    derived = () if seen.array in _OF_A_STATE or seen.array == PREVIOUS_ACTION else (seen.array,)
    places, less = np.array(seen.places, int), np.array(seen.less, int)

    def measure(context: StepContext) -> jax.Array:
        if seen.array == PREVIOUS_ACTION:
            return context.action
        after = context.after
        values = (after.derived[seen.array] if derived else getattr(after, seen.array)).ravel()
        return values[places] - values[less] if seen.less else values[places]

    return BoundTerm(derived, measure)


# Fields of PhysicsState itself.
_OF_A_STATE = ("qpos", "qvel", "act")


def observed(term: ObservationTerm, parts: ModelIndex) -> Numbers:  # noqa: C901 # A table.
    """Where the term's observation [n] is in MuJoCo's arrays."""
    model = parts.model
    match term:
        case Qpos():
            return numbers("qpos", visible_positions(parts, term.root_position))
        case Qvel():
            return numbers("qvel", range(model.nv))
        case PreviousAction():
            return numbers(PREVIOUS_ACTION, range(model.nu))
        case Activation():
            return numbers("act", range(model.na))
        case Sensors(names=names):
            return numbers("sensordata", sensor_places(parts, names))
        case BodyPositions(bodies=names, relative=relative):
            seen = rows("xpos", parts.bodies(names).tolist(), 3)
            less = [3 * parts.root + axis for axis in range(3)] * (len(seen.places) // 3)
            return replace(seen, less=less) if relative else seen
        case BodyOrientations(bodies=names):
            return rows("xmat", parts.bodies(names).tolist(), 9)
        case Cvel(bodies=names):
            return rows("cvel", parts.bodies(names).tolist(), 6)
        case Cinert(bodies=names):
            return rows("cinert", parts.bodies(names).tolist(), 10)
        case ActuatorForces():
            return numbers("qfrc_actuator", range(model.nv))
        case _:
            assert_never(term)


def ends(term: TerminationTerm, parts: ModelIndex) -> Ends:
    """The term as bounds on MuJoCo's numbers. Raises NotSimulated where it is none."""
    match term:
        case OutsideHeightRange(range=(low, high)):
            body = parts.body(term.body)
            start = parts.free_joint(body)
            height = numbers("xpos", [3 * body + 2]) if start is None else numbers("qpos", [start + 2])
            return Ends(height, low, high)
        case NotUpright(axis=(0.0, 0.0, up), least=least) if up > 0:
            return Ends(numbers("xmat", [9 * parts.body(term.body) + 8]), least, None)
        case NotUpright():
            raise NotSimulated("an episode ends by an axis that is not the body's z")
        case Touching():
            places = parts.sensors([sensor_name(geom, term.against) for geom in term.geoms])
            return Ends(numbers("sensordata", places), None, 0.5)
        case _:
            assert_never(term)


def _forward_velocity(term: ForwardVelocity, parts: ModelIndex) -> BoundTerm:
    body, direction = parts.body(term.body), _unit(term.direction)
    if term.of == "centre_of_mass":
        return BoundTerm(
            ("subtree_com",),
            lambda context: rewards.forward_velocity(
                context.before.derived["subtree_com"][body],
                context.after.derived["subtree_com"][body],
                direction,
                context.dt,
            ),
        )
    derived, position = parts.position(body)
    return BoundTerm(
        derived,
        lambda context: rewards.forward_velocity(
            position(context.before), position(context.after), direction, context.dt
        ),
    )


def _velocity_tracking(term: VelocityTracking, parts: ModelIndex) -> BoundTerm:
    body, wanted = parts.body(term.body), jnp.array(term.velocity, jnp.float32)
    derived, position = parts.position(body)
    turned = term.frame == "body"

    def measure(context: StepContext) -> jax.Array:
        velocity = rewards.velocity(position(context.before), position(context.after), context.dt)
        if turned:
            velocity = context.after.derived["xmat"][body].reshape(3, 3).T @ velocity
        return rewards.velocity_tracking(velocity[:2], wanted, term.tolerance)

    return BoundTerm((*derived, "xmat") if turned else derived, measure)


def _upright(term: Upright | NotUpright, parts: ModelIndex) -> BoundTerm:
    body, axis = parts.body(term.body), _unit(term.axis)
    return BoundTerm(
        ("xmat",), lambda context: rewards.upright(context.after.derived["xmat"][body].reshape(3, 3), axis)
    )


def _in_height_range(term: HeightRange | OutsideHeightRange, parts: ModelIndex) -> BoundTerm:
    derived, position = parts.position(parts.body(term.body))
    return BoundTerm(derived, lambda context: rewards.height_range(position(context.after)[2], term.range))


def _distance(term: Distance, parts: ModelIndex) -> BoundTerm:
    derived, position = parts.position(parts.body(term.body))
    if term.target is None:
        point = jnp.array(term.point, jnp.float32)
        return BoundTerm(derived, lambda context: rewards.distance(position(context.after), point))
    others, target = parts.position(parts.body(term.target))
    return BoundTerm(
        (*derived, *others), lambda context: rewards.distance(position(context.after), target(context.after))
    )


def _joint_limits(term: JointLimits, parts: ModelIndex) -> BoundTerm:
    joints = limited_joints(parts, term.joints)
    places = parts.model.jnt_qposadr[joints]
    low, high = jnp.asarray(parts.model.jnt_range[joints].T, jnp.float32)
    return BoundTerm(
        (), lambda context: rewards.joint_limits(context.after.qpos[places], low, high, term.share)
    )


def _num_touching(term: Contact | Touching, parts: ModelIndex) -> BoundTerm:
    places = parts.sensors([sensor_name(geom, term.against) for geom in term.geoms])
    return BoundTerm(
        ("sensordata",), lambda context: rewards.contact(context.after.derived["sensordata"][places])
    )


def _unit(vector: tuple[float, float, float]) -> jax.Array:
    return jnp.asarray(np.asarray(vector) / np.linalg.norm(vector), jnp.float32)


def visible_positions(
    parts: ModelIndex, root_position: Literal["all", "height", "none"] | None
) -> np.ndarray:
    """Places in qpos that are observed: all, all but the root's x and y, or all but its x, y and z."""
    start = parts.free_joint(parts.root)
    if start is None or root_position == "all":
        hidden = []
    elif root_position == "none":
        hidden = [start, start + 1, start + 2]
    else:
        hidden = [start, start + 1]
    return np.setdiff1d(np.arange(parts.model.nq), hidden)


def sensor_places(parts: ModelIndex, names: list[str] | None) -> np.ndarray:
    """Places in sensordata: of the named sensors in their order, or of all of the model's own."""
    if names is not None:
        return parts.sensors(names)
    own = [sensor for sensor in range(parts.model.nsensor) if not is_ours(parts.model.sensor(sensor).name)]
    starts, sizes = parts.model.sensor_adr, parts.model.sensor_dim
    return np.concatenate([np.arange(starts[sensor], starts[sensor] + sizes[sensor]) for sensor in own])


def limited_joints(parts: ModelIndex, names: list[str] | None) -> np.ndarray:
    """Numbers of these joints; if None, of all hinges and slides that have a range."""
    if names is not None:
        return np.array([parts.model.joint(name).id for name in names])
    kinds = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    return np.flatnonzero(parts.model.jnt_limited.astype(bool) & np.isin(parts.model.jnt_type, kinds))
