"""All terms that a task may be made of, by their kinds."""

from typing import Annotated

from core.environments.terms.foot_terms import FootObservation, FootReward
from core.environments.terms.imitation import ImitationReward, ReferenceAhead
from core.environments.terms.locomotion import WalkingObservation, WalkingReward
from core.environments.terms.observations import NumbersOfMujoco, ObservationTerm
from core.environments.terms.randomized import Randomized
from core.environments.terms.rewards import CommonReward
from core.environments.terms.term import Kinds, RewardTerm
from core.environments.terms.terrain import HeightScan
from core.environments.terms.tracking import Command, TrackingReward

REWARDS = Kinds(RewardTerm, "measure")
OBSERVATIONS = Kinds(ObservationTerm, "measure", "size", "slices")

_Observation = NumbersOfMujoco | WalkingObservation | FootObservation | Command | HeightScan | ReferenceAhead
AnyObservation = Annotated[_Observation, OBSERVATIONS]
# No robot knows which physics was drawn for it, so only a value function may see that.
AnyCriticObservation = Annotated[_Observation | Randomized, OBSERVATIONS]
AnyReward = Annotated[CommonReward | WalkingReward | FootReward | TrackingReward | ImitationReward, REWARDS]
