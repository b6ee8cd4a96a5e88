"""The observations and rewards of robots that walk by command: the catalog's, and users' by a recipe."""

from collections.abc import Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True)
class TorsoTerms:
    """tilt: the tolerance of `flat_orientation`. climbing, turning: the weights of `vertical_velocity` and of
    `track_angular_velocity`. By default those for the flat."""

    tilt: float = 0.3
    climbing: float = 0.5
    turning: float = 2.0


ON_THE_FLAT = TorsoTerms()


def walking_reward(
    swing: float,
    posture: Posture,
    of_actions: Sequence[AnyReward] = (),
    of_joints: Sequence[AnyReward] = (),
    torso: TorsoTerms = ON_THE_FLAT,
) -> list[AnyReward]:
    """The reward's terms. swing: the highest point of a foot's swing, in m. of_actions, of_joints: further
    terms, in their places of the sum."""
    return [
        TrackLinearVelocity(weight=2.0),
        TrackAngularVelocity(weight=torso.turning),
        SwingHeight(height=swing),
        FlatOrientation(tolerance=torso.tilt),
        posture,
        ActionRate(weight=0.02),
        *of_actions,
        RollPitchRate(weight=0.05),
        VerticalVelocity(weight=torso.climbing),
        FootSlip(weight=0.1),
        JointVelocityCost(weight=0.0005),
        *of_joints,
        StandStill(weight=0.05),
    ]
