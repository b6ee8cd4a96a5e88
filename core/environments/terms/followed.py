"""The parts of a body that follows a reference, and how far they are from it in a step."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from core.environments.body_position import free_joint_of
from core.environments.terms import rotations
from core.environments.terms.reference import Frame, Reference
from core.environments.terms.term import Array
from core.patterns import matching

if TYPE_CHECKING:
    from core.environments.terms.step import Step


_MOVING = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@dataclass(frozen=True)
class Followed:
    """bodies: the numbers of the bodies that a `Frame` holds. compared, end_effectors: places among them, and
    anchor: the place of one. root: the first index of the root's free joint in qpos. joints: places in qpos
    of all hinges and slides. tree_roots: of each of the bodies that at which its kinematic tree begins.
    """

    bodies: np.ndarray
    compared: np.ndarray
    end_effectors: np.ndarray
    anchor: int
    root: int
    joints: np.ndarray
    tree_roots: np.ndarray

    @classmethod
    def of(cls, reference: Reference, model: mujoco.MjModel, root: int) -> "Followed":
        """root: number of the root body, which has a free joint. The names are in the model."""
        compared = compared_numbers(reference, model)
        carriers = {int(model.body_parentid[body]) for body in compared}
        ends = _ends(reference, model, compared, carriers)
        anchor = root if reference.anchor is None else int(model.body(reference.anchor).id)
        bodies = sorted({*compared, *ends, anchor})
        start = free_joint_of(model, root)
        assert start is not None  # noqa: S101 - a reference needs a free root
        return cls(
            bodies=np.array(bodies),
            compared=np.array([bodies.index(body) for body in compared]),
            end_effectors=np.array([bodies.index(body) for body in ends]),
            anchor=bodies.index(anchor),
            root=start,
            joints=model.jnt_qposadr[np.isin(model.jnt_type, _MOVING)],
            tree_roots=model.body_rootid[bodies],
        )

    def poses(self, physics: Any) -> tuple[Array, Array]:
        """Positions [bodies, 3] in m and orientations [bodies, 4]."""
        return physics.derived["xpos"][self.bodies], physics.derived["xquat"][self.bodies]

    def velocities(self, derived: Mapping[str, Any], xp: ModuleType) -> tuple[Array, Array]:
        """Those of the bodies' origins along the world's axes [bodies, 3] in m/s, and about them in rad/s.

        MuJoCo's `cvel` is that of the point of a body that is where its tree's centre of mass is.
        """
        moving = derived["cvel"][self.bodies]
        arm = derived["xpos"][self.bodies] - derived["subtree_com"][self.tree_roots]
        turning = moving[:, :3]
        return moving[:, 3:] + xp.cross(turning, arm), turning

    def root_offset(self, step: "Step") -> Array:
        """From where the root is to be to where it is, [3] in m."""
        place = slice(self.root, self.root + 3)
        return step.after.qpos[place] - step.reference.now.qpos[place]

    def joint_offsets(self, step: "Step", places: np.ndarray | None = None) -> Array:
        """From where joints are to be to where they are, [joints] in rad or m. places: in qpos; None: of all
        hinges and slides."""
        chosen = step.places(self.joints if places is None else places)
        return step.after.qpos[chosen] - step.reference.now.qpos[chosen]

    def root_turn(self, step: "Step") -> Array:
        """The angle of the root to the reference's, [] in rad."""
        place = slice(self.root + 3, self.root + 7)
        return rotations.angle_between(step.after.qpos[place], step.reference.now.qpos[place], step.xp)

    def turn_back(self, step: "Step") -> Array:
        """The turn [4] from the world's frame to the root's."""
        turn = step.after.qpos[self.root + 3 : self.root + 7]
        return rotations.conjugate(turn / step.xp.linalg.norm(turn), step.xp)

    def anchor_lift(self, step: "Step") -> Array:
        """How much higher the anchor is than in the reference, [] in m."""
        height = step.after.derived["xpos"][self.bodies[self.anchor], 2]
        return height - step.reference.now.positions[self.anchor, 2]

    def offsets(self, step: "Step", rows: np.ndarray) -> Array:
        """From where bodies are to be to where they are, [rows, 3] in m: about the anchor."""
        xp, now = step.xp, step.reference.now
        positions, orientations = self.poses(step.after)
        here, there = positions[self.anchor], now.positions[self.anchor]
        ways = rotations.rotated(self._heading(orientations, now, step), now.positions[rows] - there, xp)
        base = xp.stack([here[0], here[1], there[2]])
        return positions[rows] - base - ways

    def turns(self, step: "Step", rows: np.ndarray) -> Array:
        """The angles of bodies to the reference's, [rows] in rad: headed as the anchor is."""
        now = step.reference.now
        _, orientations = self.poses(step.after)
        wanted = rotations.product(self._heading(orientations, now, step), now.orientations[rows], step.xp)
        return rotations.angle_between(orientations[rows], wanted, step.xp)

    def _heading(self, orientations: Array, now: Frame, step: "Step") -> Array:
        """The turn about the vertical [4] that heads the reference's anchor as the body's."""
        back = rotations.conjugate(now.orientations[self.anchor], step.xp)
        return rotations.heading(rotations.product(orientations[self.anchor], back, step.xp), step.xp)


def compared_numbers(reference: Reference, model: mujoco.MjModel) -> list[int]:
    """The numbers of the bodies that are compared: see `reference.compared_bodies`."""
    if reference.bodies is None:
        return [body for body in range(1, model.nbody) if model.body_jntnum[body]]
    names = [model.body(number).name for number in range(1, model.nbody)]
    return [names.index(name) + 1 for name in matching(reference.bodies, names)]


def _ends(reference: Reference, model: mujoco.MjModel, compared: list[int], carriers: set[int]) -> list[int]:
    if reference.end_effectors is None:
        return [body for body in compared if body not in carriers]
    names = [model.body(number).name for number in range(1, model.nbody)]
    return [names.index(name) + 1 for name in matching(reference.end_effectors, names)]
