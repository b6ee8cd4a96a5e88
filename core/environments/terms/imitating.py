"""What bodies that imitate see and earn: those of the catalog, and users' own to begin with."""

from collections.abc import Sequence

from core.environments.terms.imitation import (
    ReferenceAhead,
    TrackBodyOrientations,
    TrackBodyPositions,
    TrackBodyVelocities,
    TrackEndEffectors,
    TrackJoints,
    TrackJointVelocities,
    TrackRootOrientation,
    TrackRootPosition,
)
from core.environments.terms.locomotion import (
    BaseAngularVelocity,
    BaseLinearVelocity,
    JointPositions,
    JointVelocities,
    ProjectedGravity,
)
from core.environments.terms.observations import PreviousAction
from core.environments.terms.rewards import ActionRate
from core.environments.terms.vocabulary import AnyObservation, AnyReward

OBSERVATION: list[AnyObservation] = [
    ReferenceAhead(),
    BaseLinearVelocity(),
    BaseAngularVelocity(scale=0.25),
    ProjectedGravity(),
    JointPositions(),
    JointVelocities(scale=0.05),
    PreviousAction(),
]


def imitating_reward(size: float = 1.0, of_joints: Sequence[AnyReward] = ()) -> list[AnyReward]:
    """The reward's terms. size: what lengths are like beside those of a human, to which tolerances in m
    belong. of_joints: further terms."""
    return [
        TrackRootPosition(weight=1.0, tolerance=0.3 * size),
        TrackRootOrientation(weight=0.5),
        TrackJoints(weight=1.0),
        TrackJointVelocities(weight=0.5),
        TrackBodyPositions(weight=1.0, tolerance=0.3 * size),
        TrackBodyOrientations(weight=0.5),
        TrackBodyVelocities(weight=0.5, tolerance=size),
        TrackEndEffectors(weight=0.5, tolerance=0.1 * size),
        ActionRate(weight=0.02),
        *of_joints,
    ]
