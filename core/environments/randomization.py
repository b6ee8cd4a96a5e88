"""The physics that a job may vary between environments; without numerical code, so that the API checks it."""

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from pydantic import AfterValidator, Field, model_validator

from core.bounds import LONGEST_NAME, Real
from core.documents import Strict
from core.patterns import PATTERNS, Pattern

FieldName = Literal[
    "actuator_biasprm",
    "actuator_dynprm",
    "actuator_forcerange",
    "actuator_gainprm",
    "actuator_gear",
    "body_inertia",
    "body_ipos",
    "body_mass",
    "dof_armature",
    "dof_damping",
    "dof_frictionloss",
    "geom_friction",
    "geom_solref",
    "jnt_stiffness",
    "opt.gravity",
]
Name = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME)]
Kind = Literal["actuator", "body", "geom", "joint"]


@dataclass(frozen=True)
class FieldInfo:
    """A field of the model. kind: of the objects that have it, None for the model as a whole. size: numbers
    per object.

    positive: whether negative numbers are refused. changes_constants: whether MuJoCo derives constants
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
    "body_ipos": FieldInfo("body", 3, changes_constants=True),
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
    """One difference between environments: each changes a field of MuJoCo's model by a random number.

    An environment draws new numbers at each fresh start and, with `every_s`, also later in an episode. With
    `reset_pool_size` 0, all its episodes have the same ones.
    """

    field: FieldName = Field(
        description="A field of the model, by MuJoCo's name.", examples=["geom_friction"]
    )
    names: list[Pattern] | None = Field(
        default=None,
        min_length=1,
        max_length=1000,
        description=f"Which geoms, bodies, joints or actuators; null: all that the model has. {PATTERNS}",
    )
    axis: int | None = Field(
        default=None,
        ge=0,
        le=9,
        description="Index of the number to change, where the field has several (`geom_friction`: 0 sliding, "
        "1 torsional, 2 rolling); null: change all of them alike.",
    )
    operation: Literal["scale", "add", "set"] = Field(
        default="scale", description="How the drawn number changes the model's own value."
    )
    range: Annotated[tuple[Real, Real], Field(strict=False)] = Field(
        description="[lowest, highest], in MuJoCo's units.", examples=[[0.6, 1.4]]
    )
    distribution: Literal["uniform", "log_uniform"] = "uniform"
    each: bool = Field(
        default=False, description="Draw a number for each of the names, instead of one for all of them."
    )
    recompute_inertia: bool = Field(
        default=False,
        description="Of `body_mass`: the body's inertia changes in the same ratio, as if its density did.",
    )
    draw: Name | None = Field(
        default=None,
        description="Rules with the same name here share a draw: their numbers lie at the same fraction of "
        "their ranges, so that a gain and its bias can be scaled together.",
    )
    every_s: float | None = Field(
        default=None,
        gt=0,
        le=1000,
        description="Seconds after which a running episode gets a new number; null: it keeps its own.",
    )

    @model_validator(mode="after")
    def _goes_together(self) -> "Randomization":
        low, high = self.range
        about = FIELDS[self.field]
        if low > high:
            raise ValueError(f"range must be [low, high] with low <= high, not [{low:g}, {high:g}]")
        if self.distribution == "log_uniform" and low <= 0:
            raise ValueError(f"a log_uniform range must be above 0, but this one begins at {low:g}")
        if self.operation == "scale" and low < 0:
            raise ValueError(f"a scale must not be negative, but this range begins at {low:g}")
        if self.operation == "set" and about.positive and low < 0:
            raise ValueError(f"{self.field} must not be negative, but this range begins at {low:g}")
        if self.axis is not None and self.axis >= about.size:
            numbers = "one number" if about.size == 1 else f"{about.size} numbers"
            raise ValueError(f"axis = {self.axis}, but {self.field} has {numbers}, counted from 0")
        if about.kind is None and (self.names or self.each):
            raise ValueError(f"{self.field} belongs to the whole model; it takes neither names nor each")
        if self.recompute_inertia and self.field != "body_mass":
            raise ValueError(f"recompute_inertia goes with body_mass, not with {self.field}")
        if self.every_s is not None and about.changes_constants:
            raise ValueError(
                f"{self.field} stays the same in an episode, because MuJoCo derives constants of the whole "
                "model from it: leave every_s out"
            )
        return self

    @property
    def fields(self) -> list[FieldName]:
        """All that it changes."""
        return [self.field, *(["body_inertia"] if self.recompute_inertia else [])]


def _at_one_time(rules: list[Randomization]) -> list[Randomization]:
    """Refuse rules that change a field together, or share a draw, but not at the same times."""
    first = dict[tuple[str, str], int]()
    for number, rule in enumerate(rules):
        shared = [("change", rule.field), *([("share the draw", rule.draw)] if rule.draw else [])]
        for does, what in shared:
            other = first.setdefault((does, what), number)
            if rules[other].every_s != rule.every_s:
                raise ValueError(f"rules {other} and {number} {does} {what!r}, so every_s must be the same")
    return rules


Randomizations = Annotated[list[Randomization], Field(max_length=64), AfterValidator(_at_one_time)]

assert set(get_args(FieldName)) == set(FIELDS)  # noqa: S101 - a table of constants
