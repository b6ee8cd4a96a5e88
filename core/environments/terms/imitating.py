"""What bodies that imitate see and earn: those of the catalog, and users' own to begin with."""

from collections.abc import Sequence

from pydantic import BaseModel

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
from core.environments.terms.reference import Reference
from core.environments.terms.rewards import ActionRate
from core.environments.terms.vocabulary import AnyObservation, AnyReward
from core.patterns import Patterns

OBSERVATION: list[AnyObservation] = [
    ReferenceAhead(),
    BaseLinearVelocity(),
    BaseAngularVelocity(scale=0.25),
    ProjectedGravity(),
    JointPositions(),
    JointVelocities(scale=0.05),
    PreviousAction(),
]


IMITATE = "imitate"
NEEDS_CLIPS = (
    "The task imitate needs `reference`, with the clips to follow: "
    '{"clips": [{"file": "sha256:…"}]} takes those of a file that `POST /clips` took'
)

IS_UNREAD = '`reference` is followed by the task imitate alone: give `task`: "imitate", or leave it out'


def check_task(options: BaseModel, task: str, reference: Reference | None, *unread: str) -> None:
    """Raises ValueError where the task imitate has no reference, another one has one, or the task imitate has
    values for options that it does not read. unread: their names."""
    if (task == IMITATE) != (reference is not None):
        raise ValueError(NEEDS_CLIPS if reference is None else IS_UNREAD)
    if task != IMITATE:
        return
    fields = type(options).model_fields
    if given := [name for name in unread if getattr(options, name) != fields[name].default]:
        named, verb = ", ".join(f"`{name}`" for name in given), "is" if len(given) == 1 else "are"
        it = "it" if len(given) == 1 else "them"
        raise ValueError(f"{named} {verb} not read by the task {IMITATE}: leave {it} out")


def imitating_reward(
    size: float = 1.0, joints: Patterns | None = None, root: Sequence[TrackRootPosition] = ()
) -> list[AnyReward]:
    """The reward's terms. size: the body's, as a share of a human's. joints: those that are compared; None:
    all. root: the terms of the root's position; none: one whose tolerance is proportional to the size."""
    return [
        *(root or [TrackRootPosition(weight=1.0, tolerance=0.3 * size)]),
        TrackRootOrientation(weight=0.5),
        TrackJoints(weight=1.0, joints=joints),
        TrackJointVelocities(weight=0.5, joints=joints),
        TrackBodyPositions(weight=1.0, tolerance=0.3 * size),
        TrackBodyOrientations(weight=0.5),
        TrackBodyVelocities(weight=0.5, tolerance=size),
        TrackEndEffectors(weight=0.5, tolerance=0.1 * size),
        ActionRate(weight=0.02),
    ]
