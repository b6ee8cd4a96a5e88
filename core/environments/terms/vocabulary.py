"""All terms that a task may be made of, by their kinds."""

from typing import Annotated

from pydantic import Field

from core.environments.terms.locomotion import WalkingObservation, WalkingReward
from core.environments.terms.observations import NumbersOfMujoco
from core.environments.terms.rewards import CommonReward

AnyObservation = Annotated[NumbersOfMujoco | WalkingObservation, Field(discriminator="kind")]
AnyReward = Annotated[CommonReward | WalkingReward, Field(discriminator="kind")]
