"""How an episode begins: a job's options."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from core.bounds import MOST_ITEMS, Real
from core.documents import Strict
from core.environments.mjcf.vocabulary.parts import Name
from core.environments.options import NoiseScale


class Reset(Strict):
    """How an episode begins; by default in the model's initial state with a little noise."""

    keyframe: Name | Annotated[int, Field(ge=0, le=MOST_ITEMS)] | None = Field(
        default=None,
        description="By name or number: its positions, velocities and states of actuators. null: the "
        "model's custom numeric `init_qpos`, or else `qpos0`.",
    )
    qpos: Annotated[list[Real], Field(min_length=1, max_length=MOST_ITEMS)] | None = Field(
        default=None, description="Initial positions, in MuJoCo's order."
    )
    position_noise: NoiseScale = Field(default=0.01, description="Uniform in ± this: m, rad.")
    velocity_noise: NoiseScale = Field(default=0.01, description="See velocity_distribution: m/s, rad/s.")
    velocity_distribution: Literal["uniform", "normal"] = Field(
        default="uniform", description="Uniform in ± velocity_noise, or normal with that standard deviation."
    )

    @model_validator(mode="after")
    def _begins_once(self) -> Self:
        if self.keyframe is not None and self.qpos is not None:
            raise ValueError("give either keyframe or qpos")
        return self
