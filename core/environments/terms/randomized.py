"""The numbers of a model that a job's `randomization` draws, for its value function."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from core.environments.info import Slice, named
from core.environments.randomization import FIELDS, FieldName
from core.environments.terms.inventory import Inventory, ModelParts
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.term import Array, Names

if TYPE_CHECKING:
    from core.environments.terms.step import ModelIndex, Step

_DOFS = {"free": 6, "ball": 3, "slide": 1, "hinge": 1}


class Randomized(ObservationTerm):
    """(x − x*) / |x*|: how far a field's values x are from the model's own x*; where that is 0, the
    difference. 0 where nothing was drawn."""

    kind: Literal["randomized"] = "randomized"
    field: FieldName = Field(
        description="A field of the model, by MuJoCo's name, that `randomization` changes."
    )
    names: Names | None = Field(
        default=None, description="Which geoms, bodies, joints or actuators; null: all that the model has."
    )
    axis: Annotated[int, Field(ge=0, le=9)] | None = Field(
        default=None, description="Index of the number, where the field has several; null: all of them."
    )

    def size(self, parts: ModelParts) -> int:
        return sum(number for _, number in self._rows(parts.model)) * len(self._columns)

    def slices(self, parts: ModelParts) -> Iterable[Slice]:
        several = len(self._columns) > 1
        yield named(
            f"randomized {self.field}",
            (
                " ".join(part for part in (name, str(column) if several else "") if part)
                for name, number in self._rows(parts.model)
                for _ in range(number)
                for column in self._columns
            ),
            "1",
        )

    def measure(self, step: "Step", model: "ModelIndex") -> Array:
        rows, columns = model.rows(self.field, self.names), self._columns
        own = model.field(self.field)[rows][:, columns].ravel()
        drawn = step.after.model.get(self.field)
        if drawn is None:
            return step.array(0.0 * own)
        values = drawn.reshape(-1, FIELDS[self.field].size)[rows][:, columns].ravel()
        return (values - step.array(own)) / step.array([abs(number) or 1.0 for number in own])

    @property
    def _columns(self) -> list[int]:
        return list(range(FIELDS[self.field].size)) if self.axis is None else [self.axis]

    def _rows(self, model: Inventory) -> Sequence[tuple[str, int]]:
        """The objects that have the field, and how many rows each has."""
        kind = FIELDS[self.field].kind
        if kind is None:
            return [("", 1)]
        if kind == "joint" and self.field.startswith("dof_"):
            rows = {joint.name: _DOFS[joint.type] for joint in model.joints}
            all_of_them = [(joint.name, _DOFS[joint.type]) for joint in model.joints]
            return all_of_them if self.names is None else [(name, rows[name]) for name in self.names]
        names = (
            self.names
            or {
                "actuator": model.acting,
                "body": _padded(model.bodies, model.sizes.nbody),
                "geom": _padded(model.geoms, model.sizes.ngeom),
                "joint": [joint.name for joint in model.joints],
            }[kind]
        )
        return [(name, 1) for name in names]


def _padded(names: Sequence[str], number: int) -> Sequence[str]:
    """The names, if all have one; otherwise it is not known which is whose."""
    return names if len(names) == number else [""] * number
