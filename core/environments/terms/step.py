"""A step of one environment as terms see it, and the places of a model's parts in MuJoCo's arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Literal

import mujoco
import numpy as np

from core.environments.body_position import free_joint_of, slides_of
from core.environments.model_rows import object_names, rows_of
from core.environments.randomization import FIELDS, FieldName
from core.environments.terms.describe import touchable
from core.environments.terms.feet import Foot
from core.environments.terms.followed import Followed
from core.environments.terms.memory import FootTimes
from core.environments.terms.readings import ContactCount, ContactForce, ContactNetForce, is_added
from core.environments.terms.reference import Following
from core.environments.terms.term import Array
from core.environments.terms.terrain import Ground
from core.patterns import by_name, matching
from mujoco_compiled import model_field

# A command below this norm (m/s, rad/s; m to a point) is to stand still.
_STANDING = 0.05


@dataclass(frozen=True)
class Step:
    """before, after: the physics before and after it, a `PhysicsState` or what has its fields. action,
    previous_action: the policy's own [n], each in [-1, 1]; the latter is zero in an episode's first step. dt:
    its duration in seconds. xp: the library of its arrays, `jax.numpy` or `numpy`. command: [n], as its
    action knew it; None without one. target: what was drawn, of commands that follow from it. phases: of the
    gait's clock, [feet] in rad. control: [nu], what the action set. ground: None without a terrain.
    following: the reference; None without one.

    For terms that remember them: previous_action; start: the root's position [3] at the episode's start, in
    m; foot_times; earlier_action: [n], the one before the previous one.
    """

    before: Any
    after: Any
    action: Array
    previous_action: Array
    dt: float
    xp: ModuleType
    command: Array = None
    target: Array = None
    phases: Array = None
    start: Array = None
    foot_times: FootTimes | None = None
    earlier_action: Array = None
    control: Array = None
    ground: Ground | None = None
    following: Following | None = None

    @property
    def is_moving(self) -> Array:
        """Whether the command is to move, []."""
        return self.xp.sum(self.command[:3] ** 2) > _STANDING**2

    @property
    def command_speed(self) -> Array:
        """‖c_xy‖ + |c_turn| of a command of velocity, []: m/s and rad/s, added up."""
        return self.xp.sqrt(self.xp.sum(self.command[:2] ** 2)) + abs(self.command[2])

    def while_moving(self, value: Array) -> Array:
        """The value [], or 0 while the command is to stand."""
        return value if self.command is None else self.xp.where(self.is_moving, value, 0.0)

    @property
    def times(self) -> FootTimes:
        """Those of the feet, which the task carries for the terms that say that they remember them."""
        assert self.foot_times is not None  # noqa: S101 - a term that does not say so
        return self.foot_times

    @property
    def reference(self) -> Following:
        """What the body follows, for terms that need it."""
        assert self.following is not None  # noqa: S101 - a task without a reference
        return self.following

    def array(self, values: Sequence[float] | np.ndarray) -> Array:
        """[n] float32."""
        return self.xp.asarray(values, self.xp.float32)

    def places(self, numbers: np.ndarray) -> np.ndarray | slice:
        """Indices [n] of an array; a slice where they follow each other, which costs less."""
        if numbers.size and (np.diff(numbers) == 1).all():
            return slice(int(numbers[0]), int(numbers[-1]) + 1)
        return numbers


@dataclass(frozen=True)
class ModelIndex:
    """The model's parts by name. root: number of the body of the terms that name no body.

    pose: positions [nq] in which episodes begin, before noise. feet: in the order of the gait.
    num_commands, num_targets, num_actions: how many numbers a command has, what it follows from, and an
    action. followed_parts: of a body that follows a reference; frames_ahead: of which it sees so many.
    """

    model: mujoco.MjModel
    root: int
    pose: np.ndarray
    feet: Sequence[Foot]
    num_commands: int = 3
    num_actions: int = 0
    num_targets: int = 2
    followed_parts: Followed | None = None
    frames_ahead: int = 0

    @property
    def followed(self) -> Followed:
        """The parts that follow a reference, for terms that need one."""
        assert self.followed_parts is not None  # noqa: S101 - a task without a reference
        return self.followed_parts

    def body(self, name: str | None) -> int:
        return self.root if name is None else int(self.model.body(name).id)

    def bodies(self, names: list[str] | None) -> np.ndarray:
        """Numbers of the bodies; if None, of all but the world."""
        if names is None:
            return np.arange(1, self.model.nbody)
        return np.array([self.model.body(name).id for name in names])

    def sensors(self, names: list[str] | None) -> np.ndarray:
        """Places in `sensordata`: of the named sensors in their order, or of all of the model's own."""
        model = self.model
        own = (number for number in range(model.nsensor) if not is_added(model.sensor(number).name))
        chosen = list(own if names is None else (model.sensor(name).id for name in names))
        return np.concatenate(
            [sensor.adr[0] + np.arange(sensor.dim[0]) for sensor in map(model.sensor, chosen)]
        )

    def contacts(self, geoms: list[str], against: str | None) -> np.ndarray:
        """Places in `sensordata` of the numbers of contacts of each geom."""
        return self.sensors([ContactCount(geom, against).sensor for geom in geoms])

    def contacts_by_body(self, patterns: Sequence[str]) -> list[np.ndarray]:
        """Of each body that can touch something, the places of the numbers of contacts of its geoms."""
        by_body = dict[str, list[int]]()
        for geom in touchable(self.model)[0]:
            by_body.setdefault(self.model.body(self.model.geom_bodyid[geom]).name, []).append(geom)
        return [self._counts(by_body[name]) for name in matching(patterns, by_body)]

    def _counts(self, geoms: Sequence[int]) -> np.ndarray:
        return self.contacts([name for geom in geoms if (name := self.model.geom(geom).name)], None)

    def foot_contacts(self, step: Step) -> Array:
        """1 where a foot touches something, otherwise 0, [feet]."""
        counts = step.after.derived["sensordata"]
        touching = step.xp.stack([step.xp.max(counts[self._counts(foot.geoms)]) for foot in self.feet])
        return step.xp.where(touching > 0, 1.0, 0.0)

    def foot_forces(self, step: Step) -> Array:
        """The sum of the normal forces on each foot in the last physics step, [feet] in N."""
        forces, sums = step.after.derived["sensordata"], list[Array]()
        for foot in self.feet:
            sums.append(step.xp.sum(forces[self._on(foot, ContactForce)]))
        return step.xp.stack(sums)

    def foot_net_forces(self, step: Step) -> Array:
        """The sum of all forces on each foot in the last physics step, [feet, 3] in N, up to their sign."""
        forces = step.after.derived["sensordata"]
        of_bodies = [forces[self._on(foot, ContactNetForce)].reshape(-1, 3) for foot in self.feet]
        return step.xp.stack([step.xp.sum(each, 0) for each in of_bodies])

    def _on(self, foot: Foot, reading: type[ContactForce | ContactNetForce]) -> np.ndarray:
        """Places in `sensordata` of what is read of each body of the foot that has geoms."""
        bodies = dict.fromkeys(int(body) for body in self.model.geom_bodyid[list(foot.geoms)])
        return self.sensors([reading(self.model.body(body).name).sensor for body in bodies])

    def field(self, name: FieldName) -> np.ndarray:
        """The model's own values of a field, [rows, numbers of each]."""
        return np.asarray(model_field(self.model, name)).reshape(-1, FIELDS[name].size)

    def rows(self, field: FieldName, names: Sequence[str] | None) -> np.ndarray:
        """The rows of a field that belong to these geoms, bodies, joints or actuators; None: all."""
        kind = FIELDS[field].kind
        if kind is None or names is None:
            return np.arange(len(self.field(field)))
        known = object_names(self.model, kind)
        return np.array([row for name in names for row in rows_of(self.model, field, known.index(name))], int)

    def free_joint(self, body: int) -> int | None:
        """The first index of the body's free joint in qpos; None if it has none."""
        return free_joint_of(self.model, body)

    def position(self, physics: Any, body: int) -> Array:
        """The body's position [3], in metres."""
        if (start := self.free_joint(body)) is not None:
            return physics.qpos[start : start + 3]
        slides = slides_of(self.model, body)
        return physics.derived["xpos"][body] if slides is None else slides.position(physics.qpos)

    def place(self, physics: Any, body: int, of: Literal["body", "centre_of_mass"]) -> Array:
        """Where the body, or its subtree's centre of mass, is, [3] in m."""
        return self.position(physics, body) if of == "body" else physics.derived["subtree_com"][body]

    def velocity(self, step: Step, body: int, of: Literal["body", "centre_of_mass"] = "body") -> Array:
        """(p' − p) / dt [3] in m/s, along the world's axes."""
        slides = slides_of(self.model, body) if of == "body" else None
        if slides is not None:
            return slides.velocity(step.before.qpos, step.after.qpos, step.dt)
        return (self.place(step.after, body, of) - self.place(step.before, body, of)) / step.dt

    def visible_positions(self, num_hidden: int, without: Sequence[str] | None = None) -> np.ndarray:
        """Places in qpos, without the first `num_hidden` of the root's free joint if it has one, and without
        the hinges and slides that one of these patterns matches."""
        start = self.free_joint(self.root)
        hidden = np.arange(num_hidden) + start if start is not None else np.array([], int)
        others = self.joint_positions(without) if without else np.array([], int)
        return np.setdiff1d(np.arange(self.model.nq), np.concatenate([hidden, others]))

    def limited_joints(self, names: list[str] | None) -> np.ndarray:
        """Numbers of these joints; if None, of all hinges and slides that have a range."""
        if names is not None:
            return np.array([self.model.joint(name).id for name in names])
        kinds = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        return np.flatnonzero(self.model.jnt_limited.astype(bool) & np.isin(self.model.jnt_type, kinds))

    def joints(self, patterns: Sequence[str] | None) -> np.ndarray:
        """Numbers of the hinges and slides, or of those that a pattern matches."""
        kinds = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        moving = np.flatnonzero(np.isin(self.model.jnt_type, kinds))
        return np.array(
            [j for j in moving if patterns is None or matching(patterns, [self.model.joint(j).name])], int
        )

    def joint_positions(self, patterns: Sequence[str] | None) -> np.ndarray:
        """Their places in qpos."""
        return self.model.jnt_qposadr[self.joints(patterns)]

    def joint_velocities(self, patterns: Sequence[str] | None) -> np.ndarray:
        """Their places in qvel."""
        return self.model.jnt_dofadr[self.joints(patterns)]

    def per_joint(self, values: Mapping[str, float]) -> np.ndarray:
        """The value of each hinge and slide, by patterns; 0 for those that none matches."""
        names = [self.model.joint(joint).name for joint in self.joints(None)]
        chosen = by_name(values, names)
        return np.array([chosen.get(name, 0.0) for name in names])

    def inverse_squares(self, widths: Mapping[str, float]) -> np.ndarray:
        """Of each hinge and slide: 1 / (n σ²), with n the number of those that a pattern gives σ; else 0."""
        chosen = self.per_joint(widths)
        has = chosen > 0
        return np.where(has, 1.0 / (np.where(has, chosen, 1.0) ** 2 * max(1, has.sum())), 0.0)

    @property
    def pose_height(self) -> float:
        """The root's in the pose, in m, above the world's origin."""
        start = self.free_joint(self.root)
        assert start is not None  # noqa: S101 - terms that need a free root
        return float(self.pose[start + 2])

    def angular_momentum(self, step: Step) -> Array:
        """Of the root and all that it carries, about their centre of mass, [3] in kg m²/s.

        The root has a free joint, so that `cinert` and `cvel` are about that centre.
        """
        number, on = self.model.nbody, self.model.body_rootid
        bodies = np.flatnonzero(on[np.arange(number)] == self.root)
        inertia, velocity = step.after.derived["cinert"][bodies], step.after.derived["cvel"][bodies]
        xx, yy, zz, xy, xz, yz = (inertia[:, i] for i in range(6))
        turn, moment = velocity[:, :3], inertia[:, 6:9]
        x, y, z = turn[:, 0], turn[:, 1], turn[:, 2]
        rows = [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z]
        return step.xp.sum(step.xp.stack(rows, 1) + step.xp.cross(moment, velocity[:, 3:]), 0)

    @property
    def root_position(self) -> int:
        """The first place in qpos of the root's free joint."""
        return int(self.model.jnt_qposadr[self.model.body_jntadr[self.root]])

    @property
    def root_velocities(self) -> slice:
        """The places in qvel of the root's free joint."""
        start = int(self.model.jnt_dofadr[self.model.body_jntadr[self.root]])
        return slice(start, start + 6)

    def velocities(self, step: Step) -> Array:
        """Those of the root's free joint [6]: linear along the world's axes, angular about its own."""
        return step.after.qvel[self.root_velocities]

    def base_linear_velocity(self, step: Step) -> Array:
        """The root's, along its own axes, [3] in m/s."""
        return self._turned_back(step, self.velocities(step)[:3])

    def base_angular_velocity(self, step: Step) -> Array:
        """The root's, about its own axes, [3] in rad/s."""
        return self.velocities(step)[3:]

    def projected_gravity(self, step: Step) -> Array:
        """The direction of gravity in the root's frame, [3]."""
        return self._turned_back(step, step.array((0.0, 0.0, -1.0)))

    def pitch(self, step: Step) -> Array:
        """How far the root leans forward, [] in rad."""
        gravity = self.projected_gravity(step)
        return step.xp.arctan2(gravity[0], -gravity[2])

    def heading(self, step: Step) -> Array:
        """Where the root's x points, from the world's x to its y, [] in rad."""
        start = int(self.model.jnt_qposadr[self.model.body_jntadr[self.root]])
        w, x, y, z = step.after.qpos[start + 3 : start + 7]
        return step.xp.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)

    def foot_heights(self, step: Step) -> Array:
        """How far the sole of each foot is above the ground below it, [feet] in m."""
        bodies = self._foot_bodies
        if step.ground is not None:
            points = step.after.derived["xpos"][bodies] + self._foot_points(step.after, step)
            radii = step.array([foot.radius for foot in self.feet])
            return points[:, 2] - radii - step.ground.height(points[:, :2], step.xp)
        below = step.array([foot.radius + foot.ground for foot in self.feet])
        return step.after.derived["xpos"][bodies, 2] + self._foot_points(step.after, step)[:, 2] - below

    def foot_velocities(self, step: Step) -> Array:
        """Of what is the lowest of each foot after the step, [feet, 3] in m/s along the world's axes.

        A round foot that rolls has none there, though its centre moves.
        """
        bodies = self._foot_bodies
        before, after = (one.derived["xpos"][bodies] for one in (step.before, step.after))
        moved = after + self._foot_points(step.after, step) - before - self._foot_points(step.before, step)
        if any(foot.radius for foot in self.feet):
            # What is below the centre by r has moved by d − R R'ᵀ d beside the centre, with d = (0, 0, −r).
            down = step.array(np.array([(0.0, 0.0, -foot.radius) for foot in self.feet]))
            own = down[:, 2:] * self._foot_axes(step.after)[:, 2]
            moved = moved + down - step.xp.sum(self._foot_axes(step.before) * own[:, None, :], 2)
        return moved / step.dt

    @property
    def _foot_bodies(self) -> np.ndarray:
        return np.array([foot.body for foot in self.feet], int)

    def _foot_axes(self, physics: Any) -> Array:
        """The rotation matrices of the feet's bodies, [feet, 3, 3]."""
        return physics.derived["xmat"][self._foot_bodies].reshape(-1, 3, 3)

    def _foot_points(self, physics: Any, step: Step) -> Array:
        """Each foot's point from its body's origin, [feet, 3] in m along the world's axes.

        Not a matrix product: a GPU may round its factors to 11 bits.
        """
        points = step.array(np.array([foot.point for foot in self.feet]).reshape(-1, 3))
        return step.xp.sum(self._foot_axes(physics) * points[:, None, :], 2)

    def _turned_back(self, step: Step, vector: Array) -> Array:
        """Rᵀ v, by the unit quaternion of the root's free joint."""
        start = self.root_position
        quaternion = step.after.qpos[start + 3 : start + 7]
        xp = step.xp
        quaternion = quaternion / xp.linalg.norm(quaternion)  # Noise at a reset has changed its length.
        w, axis = quaternion[0], -quaternion[1:]
        return vector + 2.0 * xp.cross(axis, xp.cross(axis, vector) + w * vector)
