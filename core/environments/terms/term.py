"""The base of a task's terms, and the kinds of their fields.

A term is one class: its fields with bounds and units, and its formula. It imports no numerical code, since
the API reads it; its formula uses the array library of the step that it gets, `step.xp`: JAX while a policy
trains, NumPy beside MuJoCo's own data. Which fields of the physics it reads is found by evaluating it once
(`binding.bound`).
"""

from collections.abc import Iterable, Mapping, Sequence
from math import ceil, floor
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Union, get_args

from pydantic import AfterValidator, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema

from core.bounds import LONGEST_NAME, Real
from core.documents import Strict
from core.environments.options import NotDescending, OpenRange, Weight
from core.environments.terms.inventory import ModelParts
from core.environments.terms.readings import ContactCount, Reading
from core.patterns import PATTERNS, Patterns
from core.physics.availability import EngineName

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step

# An array of `step.xp`.
Array = Any
Name = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME)]
Names = Annotated[list[Name], Field(min_length=1, max_length=1000)]
Vector = Annotated[tuple[Real, Real, Real], Field(strict=False)]


def _not_zero(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(vector):
        raise ValueError("must not be [0, 0, 0]")
    return vector


Direction = Annotated[Vector, AfterValidator(_not_zero)]


Interval = Annotated[tuple[Real, Real], Field(strict=False), NotDescending]
_Seconds = Annotated[float, Field(ge=0, le=10)]
Delay = Annotated[tuple[_Seconds, _Seconds], Field(strict=False), NotDescending]
DELAY = "[lowest, highest] in s, drawn for each episode among the whole control steps in between; null: none."
# Of a control step: what a delay may miss a whole number by.
_ROUNDING = 1e-6


def whole_steps(delay: tuple[float, float] | None, control_step_s: float) -> range:
    """The delays in control steps that lie in the range, perhaps none of them; only 0 without a range."""
    low, high = delay or (0.0, 0.0)
    return range(ceil(low / control_step_s - _ROUNDING), floor(high / control_step_s + _ROUNDING) + 1)


# `free_root`: a free joint of the root. The others are fields of `TaskOptions`.
# `foot_colliders`: each foot has a geom that can touch something. `velocity_command` and so on: a command of
# this kind, or with this part.
Need = Literal[
    "command", "command_height", "command_pitch", "feet", "foot_colliders", "free_root", "gait",
    "position_command", "reference", "terrain", "velocity_command",
]  # fmt: skip
# What is carried from step to step for the terms that read it, by the names of `Step`.
Memory = Literal["earlier_action", "foot_times", "previous_action", "start"]


class Term(Strict):
    """A part of a task.

    noun: what messages call it. needs: what else the task must have. remembers: what it reads of earlier
    steps. beyond: engines that cannot read what it reads, and why.
    """

    noun: ClassVar[str] = "term"
    needs: ClassVar[frozenset[Need]] = frozenset()
    remembers: ClassVar[frozenset[Memory]] = frozenset()
    beyond: ClassVar[Mapping[EngineName, str]] = {}

    @property
    def label(self) -> str:
        """Its kind, as text."""
        return str(getattr(self, "kind", ""))

    @property
    def needed(self) -> frozenset[Need]:
        """What it needs as it is configured."""
        return self.needs

    @property
    def inner(self) -> Sequence["Term"]:
        """The terms that it is made of."""
        return ()

    def readings(self, parts: ModelParts) -> Iterable[Reading]:
        """What it reads of contacts. The parts that it names are in the model."""
        return ()

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        """The term's value after a step: [], or [n] of an observation."""
        raise NotImplementedError


class Kinds:
    """In an annotation of ours: a union of terms, told apart by their kinds, and those of packages besides.

    A pydantic model that holds such a union sees what is added later once it is built again.

    base: of those of packages. methods: what each of these has to define.
    """

    def __init__(self, base: type[Term], *methods: str) -> None:
        self.base, self.methods = base, methods
        self.added: tuple[type[Term], ...] = ()

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        ours = get_args(source) or (source,)
        if len(ours) + len(self.added) == 1:
            return handler.generate_schema(source)
        terms: Any = Union[(*ours, *self.added)]
        return handler.generate_schema(Annotated[terms, Field(discriminator="kind")])


def _with_usual_weight(schema: dict[str, Any], term: type["RewardTerm"]) -> None:
    schema["properties"]["weight"]["examples"] = [term.usual_weight]


class RewardTerm(Term):
    """A part of the reward.

    usual_weight: a first guess for a robot that walks by command, as an example in the JSON Schema.
    """

    model_config = ConfigDict(json_schema_extra=_with_usual_weight)

    sign: ClassVar[float] = 1.0
    usual_weight: ClassVar[float] = 1.0

    weight: Weight = Field(default=1.0, description="Multiplies the term.")
    name: Annotated[str, Field(pattern=r"^[a-z0-9_]{1,60}$")] | None = Field(
        default=None, description="The metric is `reward_<name>`; null: its kind."
    )


class CostTerm(RewardTerm):
    """A term that is subtracted where its weight is positive."""

    sign: ClassVar[float] = -1.0


class OfBody(Strict):
    body: Name | None = Field(default=None, description="The body's name; null: the root.")


class OfBodies(Strict):
    bodies: Names | None = Field(default=None, description="The bodies' names; null: all but the world.")


class OfAxis(OfBody):
    axis: Direction = Field(default=(0.0, 0.0, 1.0), description="An axis in the body's own frame.")

    def cosine(self, step: "Step", model: "ModelIndex") -> Array:
        """(R a)_z, the cosine of the axis' angle to the vertical, []."""
        rotation = step.after.derived["xmat"][model.body(self.body)].reshape(3, 3)
        return step.xp.dot(rotation[2], unit_vector(self.axis, step))


class OfHeight(OfBody):
    range: OpenRange = Field(
        description="[lowest, highest] in metres above the world's origin, or above the ground of a terrain; "
        "null above: no bound."
    )

    def is_inside(self, step: "Step", model: "ModelIndex") -> Array:
        """1 where the body's height is in the range, otherwise 0; 1 also for NaN. []."""
        low, high = self.range
        place = model.position(step.after, model.body(self.body))
        height = place[2]
        if step.ground is not None:
            # Over a hole, the ground about it counts.
            height = height - step.xp.maximum(step.ground.height(place[:2], step.xp), step.ground.lowest)
        outside = height < low if high is None else (height < low) | (height > high)
        return step.xp.where(outside, 0.0, 1.0)


class OfContact(Strict):
    geoms: Names = Field(description="The geoms' names.")
    against: Name | None = Field(
        default=None, description="Count only contacts with this geom; null: with any."
    )

    def readings(self, parts: ModelParts) -> Iterable[Reading]:
        return [ContactCount(geom, self.against) for geom in self.geoms]

    def num_touching(self, step: "Step", model: "ModelIndex") -> Array:
        """How many of the geoms touch something, []."""
        found = step.after.derived["sensordata"][model.contacts(self.geoms, self.against)]
        return step.xp.sum(step.xp.where(found > 0, 1.0, 0.0))


class OfBodyContact(Strict):
    bodies: Patterns = Field(description=f"The bodies; what is welded to one is not part of it. {PATTERNS}")

    def readings(self, parts: ModelParts) -> Iterable[Reading]:
        return map(ContactCount, parts.colliders_of(self.bodies))

    def num_touching(self, step: "Step", model: "ModelIndex") -> Array:
        """How many of the bodies touch something, []."""
        found = step.after.derived["sensordata"]
        counts = [step.xp.max(found[places]) for places in model.contacts_by_body(self.bodies)]
        return step.xp.sum(step.xp.where(step.xp.stack(counts) > 0, 1.0, 0.0))


def unit_vector(vector: tuple[float, float, float], step: "Step") -> Array:
    """Of length 1, [3]."""
    length = sum(part**2 for part in vector) ** 0.5
    return step.array([part / length for part in vector])
