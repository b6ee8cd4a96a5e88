"""What a job may ask to differ between worlds; imports no numerical code, so that the API may check it."""

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from pydantic import Field, model_validator

from core.documents import Strict

FieldName = Literal[
    "actuator_biasprm",
    "actuator_dynprm",
    "actuator_forcerange",
    "actuator_gainprm",
    "actuator_gear",
    "body_inertia",
    "body_mass",
    "dof_armature",
    "dof_damping",
    "dof_frictionloss",
    "geom_friction",
    "geom_solref",
    "jnt_stiffness",
    "opt.gravity",
]
Name = Annotated[str, Field(min_length=1, max_length=200)]
Kind = Literal["actuator", "body", "geom", "joint"]


@dataclass(frozen=True)
class FieldInfo:
    """A field of the model. kind: what has it, None where the whole world does. size: numbers each has.

    positive: whether numbers below 0 make no sense. changes_constants: whether MuJoCo derives constants
    from it (`mj_setConst`).
    """

    kind: Kind | None
    size: int = 1
    positive: bool = False
    changes_constants: bool = False


FIELDS: dict[FieldName, FieldInfo] = {
    "actuator_biasprm": FieldInfo("actuator", 10),
    "actuator_dynprm": FieldInfo("actuator", 10),
    "actuator_forcerange": FieldInfo("actuator", 2),
    "actuator_gainprm": FieldInfo("actuator", 10),
    "actuator_gear": FieldInfo("actuator", 6, changes_constants=True),
    "body_inertia": FieldInfo("body", 3, positive=True, changes_constants=True),
    "body_mass": FieldInfo("body", positive=True, changes_constants=True),
    "dof_armature": FieldInfo("joint", positive=True, changes_constants=True),
    "dof_damping": FieldInfo("joint", positive=True),
    "dof_frictionloss": FieldInfo("joint", positive=True),
    "geom_friction": FieldInfo("geom", 3, positive=True),
    "geom_solref": FieldInfo("geom", 2),
    "jnt_stiffness": FieldInfo("joint", positive=True),
    "opt.gravity": FieldInfo(None, 3),
}


class Randomization(Strict):
    """One thing that differs between worlds: a field of MuJoCo's model, changed by a number drawn for each.

    A world keeps its numbers for an episode. They are drawn anew with each fresh start; with
    `reset_pool_size` 0, once for the run.
    """

    field: FieldName = Field(description="By MuJoCo's name.", examples=["geom_friction"])
    names: list[Name] | None = Field(
        default=None,
        min_length=1,
        max_length=1000,
        description="Which geoms, bodies, joints or actuators; null: all that the model has.",
    )
    axis: int | None = Field(
        default=None,
        ge=0,
        le=9,
        description="Which of the field's numbers, where it has several (`geom_friction`: 0 sliding, "
        "1 torsional, 2 rolling); null: all of them alike.",
    )
    operation: Literal["scale", "add", "set"] = Field(
        default="scale", description="What the number does to the model's own value."
    )
    range: Annotated[tuple[float, float], Field(strict=False)] = Field(
        description="[lowest, highest], in MuJoCo's units.", examples=[[0.6, 1.4]]
    )
    distribution: Literal["uniform", "log_uniform"] = "uniform"
    each: bool = Field(
        default=False, description="A number for each of the names, rather than one for all of them."
    )
    draw: Name | None = Field(
        default=None,
        description="Rules with the same word here use the same draw: their numbers lie equally far up "
        "their ranges. So a gain and its bias may be scaled together.",
    )

    @model_validator(mode="after")
    def _goes_together(self) -> "Randomization":
        low, high = self.range
        about = FIELDS[self.field]
        if low > high:
            raise ValueError(f"range must be [low, high] with low <= high, not [{low:g}, {high:g}]")
        if self.distribution == "log_uniform" and low <= 0:
            raise ValueError(f"a log_uniform range must lie above 0, and this one begins at {low:g}")
        if self.operation == "scale" and low < 0:
            raise ValueError(f"a scale must not be negative, and this one begins at {low:g}")
        if self.operation == "set" and about.positive and low < 0:
            raise ValueError(f"{self.field} must not be negative, and this range begins at {low:g}")
        if self.axis is not None and self.axis >= about.size:
            numbers = "one number" if about.size == 1 else f"{about.size} numbers"
            raise ValueError(f"axis = {self.axis}, and {self.field} has {numbers}, counted from 0")
        if about.kind is None and (self.names or self.each):
            raise ValueError(f"{self.field} belongs to the whole world; it takes neither names nor each")
        return self


Randomizations = Annotated[list[Randomization], Field(max_length=64)]

assert set(get_args(FieldName)) == set(FIELDS)  # noqa: S101 - a table of constants
