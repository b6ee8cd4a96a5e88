"""All terms that a task may be made of, by their kinds."""

from typing import Annotated

from pydantic import Field

from core.environments.terms.foot_terms import FootObservation, FootReward
from core.environments.terms.locomotion import WalkingObservation, WalkingReward
from core.environments.terms.observations import NumbersOfMujoco
from core.environments.terms.randomized import Randomized
from core.environments.terms.rewards import CommonReward
from core.environments.terms.terrain import HeightScan
from core.environments.terms.tracking import Command, TrackingReward

_Observation = NumbersOfMujoco | WalkingObservation | FootObservation | Command | HeightScan
AnyObservation = Annotated[_Observation, Field(discriminator="kind")]
# No robot knows which physics was drawn for it, so only a value function may see that.
AnyCriticObservation = Annotated[_Observation | Randomized, Field(discriminator="kind")]
AnyReward = Annotated[CommonReward | WalkingReward | FootReward | TrackingReward, Field(discriminator="kind")]
