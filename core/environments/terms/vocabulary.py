"""All terms that a task may be made of, by their kinds."""

from typing import Annotated

from pydantic import Field

from core.environments.terms.foot_terms import FootObservation, FootReward
from core.environments.terms.locomotion import WalkingObservation, WalkingReward
from core.environments.terms.observations import NumbersOfMujoco
from core.environments.terms.rewards import CommonReward

AnyObservation = Annotated[
    NumbersOfMujoco | WalkingObservation | FootObservation, Field(discriminator="kind")
]
AnyReward = Annotated[CommonReward | WalkingReward | FootReward, Field(discriminator="kind")]
