"""Where an episode begins: its positions and velocities before noise, and how random ones are drawn."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments.terms.describe import touchable
from core.environments.terms.rotations import product, rotated
from core.environments.terms.starts import Fallen, PoseRange, VelocityRange
from core.environments.terms.step import ModelIndex
from core.environments.terms.task import Reset
from core.physics.model import initial_qpos

# The root's own axes: half a turn about x.
_HALF_A_TURN = (0.0, 1.0, 0.0, 0.0)


def first_positions(model: mujoco.MjModel, reset: Reset) -> np.ndarray:
    """Positions [nq] at the start of an episode, before noise."""
    if reset.qpos is not None:
        return np.array(reset.qpos)
    return initial_qpos(model) if reset.keyframe is None else np.array(model.key(reset.keyframe).qpos)


def first_motion(model: mujoco.MjModel, reset: Reset) -> tuple[jax.Array | None, jax.Array | None]:
    """The velocities [nv] and the states of actuators [na] of the keyframe; None for those that are 0."""
    if reset.keyframe is None:
        return None, None
    key = model.key(reset.keyframe)
    qvel, act = (
        jnp.asarray(values, jnp.float32) if np.any(values) else None for values in (key.qvel, key.act)
    )
    return qvel, act


class RandomStart:
    """reset: how the episodes of a task begin. model: its parts; a root that is moved has a free joint."""

    def __init__(self, reset: Reset, model: ModelIndex) -> None:
        self._reset, self._model = reset, model
        free = model.free_joint(model.root)
        self._root = slice(0, 0) if free is None else slice(free, free + 7)
        self._drop = (0.0, 0.0)
        if reset.fallen is not None:
            self._drop = reset.fallen.height or (reach(model), reach(model))

    def placed(self, key: jax.Array, qpos: jax.Array, qvel: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The positions [nq] and velocities [nv] of an episode's start. key: of these draws alone."""
        reset = self._reset
        keys = jax.random.split(key, 4)
        if reset.joints is not None:
            qpos = self._spread(keys[0], qpos, reset.joints)
        if reset.pose is not None:
            qpos, qvel = self._posed(keys[1], reset.pose, qpos, qvel)
        if reset.velocity is not None:
            change = _uniform(keys[2], reset.velocity)
            qvel = qvel.at[self._model.root_velocities].add(change)
        if reset.fallen is not None:
            qpos = self._fallen(keys[3], reset.fallen, qpos)
        return qpos, qvel

    def _spread(self, key: jax.Array, qpos: jax.Array, share: float) -> jax.Array:
        """Joints with a range, uniform in a share of it."""
        joints = self._model.limited_joints(None)
        low, high = jnp.asarray(self._model.model.jnt_range[joints].T, jnp.float32)
        part = share * (jax.random.uniform(key, (len(joints),)) - 0.5)
        return qpos.at[self._model.model.jnt_qposadr[joints]].set((low + high) / 2 + part * (high - low))

    def _posed(
        self, key: jax.Array, pose: PoseRange, qpos: jax.Array, qvel: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        drawn = _uniform(key, pose)
        turn = product(_about(2, drawn[5]), product(_about(1, drawn[4]), _about(0, drawn[3]), jnp), jnp)
        root, speeds = qpos[self._root], self._model.root_velocities
        along_the_world = slice(speeds.start, speeds.start + 3)
        changed = jnp.concatenate([root[:3] + drawn[:3], product(turn, root[3:], jnp)])
        turned = qvel.at[along_the_world].set(rotated(turn, qvel[along_the_world], jnp))
        return qpos.at[self._root].set(changed), turned

    def _fallen(self, key: jax.Array, fallen: Fallen, qpos: jax.Array) -> jax.Array:
        for_joints, for_root, for_share = jax.random.split(key, 3)
        lying = self._spread(for_joints, qpos, fallen.joints) if fallen.joints else qpos
        chance = jax.random.uniform(for_root, (4,))
        root = qpos[self._root]
        if fallen.upside_down:
            upside_down = product(root[3:], jnp.array(_HALF_A_TURN), jnp)
            turn = product(_about(2, 2.0 * jnp.pi * chance[0]), upside_down, jnp)
        else:
            turn = _anywhere(chance[:3])
        low, high = self._drop
        above_the_pose = root[2] - self._model.pose[self._root.start + 2]  # On a terrain, its ground.
        height = low + chance[3:] * (high - low) + above_the_pose
        lying = lying.at[self._root].set(jnp.concatenate([root[:2], height, turn]))
        return jnp.where(jax.random.uniform(for_share) < fallen.share, lying, qpos)


def reach(model: ModelIndex) -> float:
    """How far a geom that can touch something reaches from the root in the pose at most, in m."""
    data = mujoco.MjData(model.model)
    data.qpos[:] = model.pose
    mujoco.mj_kinematics(model.model, data)
    geoms, _ = touchable(model.model)
    of_the_root = [
        geom for geom in geoms if model.model.body_rootid[model.model.geom_bodyid[geom]] == model.root
    ]
    away = np.linalg.norm(data.geom_xpos[of_the_root] - data.xpos[model.root], axis=1)
    return float(np.max(away + model.model.geom_rbound[of_the_root], initial=0.0))


def _uniform(key: jax.Array, ranges: PoseRange | VelocityRange) -> jax.Array:
    low, high = jnp.asarray(ranges.ranges, jnp.float32).T
    return low + jax.random.uniform(key, (ranges.num_random,)) * (high - low)


def _about(axis: int, angle: jax.Array) -> jax.Array:
    """The quaternion [4] of a turn about an axis of the world."""
    return jnp.zeros(4).at[0].set(jnp.cos(angle / 2)).at[axis + 1].set(jnp.sin(angle / 2))


def _anywhere(uniform: jax.Array) -> jax.Array:
    """A quaternion [4], uniform over all rotations. uniform: [3] in [0, 1).

    Source: Shoemake, Uniform Random Rotations (1992).
    """
    low, high = jnp.sqrt(1.0 - uniform[0]), jnp.sqrt(uniform[0])
    first, second = 2.0 * jnp.pi * uniform[1], 2.0 * jnp.pi * uniform[2]
    return jnp.stack(
        [low * jnp.sin(first), low * jnp.cos(first), high * jnp.sin(second), high * jnp.cos(second)]
    )
