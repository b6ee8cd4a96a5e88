"""The observations and rewards of robots that walk by command: the catalog's, and users' by a recipe."""

from collections.abc import Sequence

from core.environments.terms.foot_terms import FootSlip, SwingHeight
from core.environments.terms.locomotion import (
    BaseAngularVelocity,
    BaseLinearVelocity,
    FlatOrientation,
    GaitPhase,
    JointPositions,
    JointVelocities,
    JointVelocityCost,
    Posture,
    ProjectedGravity,
    RollPitchRate,
    StandStill,
    VerticalVelocity,
)
from core.environments.terms.observations import PreviousAction
from core.environments.terms.rewards import ActionRate
from core.environments.terms.tracking import Command, TrackAngularVelocity, TrackLinearVelocity
from core.environments.terms.vocabulary import AnyObservation, AnyReward

OBSERVATION: list[AnyObservation] = [
    BaseLinearVelocity(),
    BaseAngularVelocity(scale=0.25),
    ProjectedGravity(),
    Command(),
    JointPositions(),
    JointVelocities(scale=0.05),
    PreviousAction(),
    GaitPhase(),
]
# On the flat: the tolerance of `flat_orientation`, and the weight of `vertical_velocity`.
TILT, CLIMBING = 0.3, 0.5


def walking_reward(
    swing: float,
    posture: Posture,
    of_actions: Sequence[AnyReward] = (),
    of_joints: Sequence[AnyReward] = (),
    *,
    tilt: float = TILT,
    climbing: float = CLIMBING,
) -> list[AnyReward]:
    """The reward's terms. swing: the highest point of a foot's swing, in m. of_actions, of_joints: further
    terms, in their places of the sum. tilt, climbing: see above."""
    return [
        TrackLinearVelocity(weight=2.0),
        TrackAngularVelocity(weight=2.0),
        SwingHeight(height=swing),
        FlatOrientation(tolerance=tilt),
        posture,
        ActionRate(weight=0.02),
        *of_actions,
        RollPitchRate(weight=0.05),
        VerticalVelocity(weight=climbing),
        FootSlip(weight=0.1),
        JointVelocityCost(weight=0.0005),
        *of_joints,
        StandStill(weight=0.05),
    ]
