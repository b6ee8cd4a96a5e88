"""A slot for each point where geoms touch: the contacts of bodies with many pairs of geoms.

All that the solver does with such contacts is a loop over slots, so that a step takes as long as there are
contacts, and code does not grow with the number of pairs. A slot is there for all lanes of a CPU's vector if
one of them touches there. In the others it has no stiffness and changes nothing: sums get zeros more, and
keep their bits. On a GPU each thread has its own slots.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

from mujoco_compiled.constraints.contacts import ContactPair, Side, law_of
from mujoco_compiled.constraints.laws import Law
from mujoco_compiled.program.arithmetic import Number, Vector, cross
from mujoco_compiled.program.memory import (
    Array,
    Column,
    Integers,
    Rows,
    array,
    column,
    for_each,
    integers,
    rows,
)
from mujoco_compiled.program.program import Place
from mujoco_compiled.smooth.tree_loops import TreeLoops


class SlotKind:
    """Contacts whose slots look alike: with as many directions, and the same sides that move.

    places: of the contacts among all of the model. first: one of them. signs: of the sides that move.
    room: for how many points there are slots. An overflow ends the episodes of those that are computed
    together.
    """

    def __init__(
        self,
        loops: TreeLoops,
        name: str,
        contacts: Sequence[ContactPair],
        places: Sequence[int],
        room: int,
    ) -> None:
        program = loops.program
        self.program, self.name, self.contacts, self.places = program, name, contacts, places
        self.first = contacts[0]
        self.signs = [sign for body, sign in zip(self.first.bodies, (-1.0, 1.0), strict=True) if body]
        self.num_directions = self.first.num_directions
        most = min(room, sum(contact.num_points for contact in contacts))
        self.slots: Rows = rows(program, f"{name} slots", most)
        # One more for what is lost.
        self.numbers: Array = array(program, f"{name} numbers", most + 1, sum(self._sizes.values()))
        moving = [[loops.rows[body] for body in contact.bodies if body] for contact in contacts]
        self.bodies = [
            self.integers(f"bodies {side}", [own[side] for own in moving]) for side in range(len(self.signs))
        ]
        self.friction = [
            self.column(f"friction {k}", [one.parameters.friction[k] for one in contacts])
            for k in range(self.num_directions - 1)
        ]
        self.reach = self.column("reach", [one.parameters.reach for one in contacts])

    @property
    def is_double(self) -> bool:
        """Whether both geoms' bodies move."""
        return len(self.signs) > 1

    @cached_property
    def _sizes(self) -> dict[str, int]:
        """By name: how many of a slot's numbers it is."""
        num_tangents = min(1, self.num_directions - 1)
        vectors = ("reference", "residual", "rates")
        return {
            **{"normal": 3, "tangent": 3 * num_tangents, "arms": 3 * len(self.signs)},
            **{"distance": 1, "stiffness": 1},
            **dict.fromkeys(vectors, self.num_directions),
        }

    def range_of(self, name: str) -> range:
        """Where a slot has its numbers of this name."""
        names = list(self._sizes)
        first = sum(self._sizes[one] for one in names[: names.index(name)])
        return range(first, first + self._sizes[name])

    def column(self, name: str, values: Sequence[Number]) -> Column:
        """A number for each contact."""
        return column(self.program, f"{self.name} {name}", values)

    def integers(self, name: str, values: Sequence[int]) -> Integers:
        """An integer for each contact."""
        return integers(self.program, f"{self.name} {name}", values)

    def each(self, body: Callable[["Slot", Vector], Vector], carried: Sequence[Number] = ()) -> Vector:
        """The carried numbers after the body for each slot."""
        length = self.slots.length()
        return for_each(self.program, length, lambda row, now: body(Slot(self, row), now), carried)


@dataclass(frozen=True)
class Slot:
    """A point where a contact may push, in a loop over those of its kind. row: its own."""

    kind: SlotKind
    row: Place

    @cached_property
    def contact(self) -> Place:
        """The row of its contact among those of its kind."""
        return self.kind.slots.at(self.row)

    @cached_property
    def axes(self) -> list[tuple[Vector, bool]]:
        """The directions: each with whether it turns. See `contacts.directions`."""
        normal, tangent = self.read("normal"), self.read("tangent")
        frame = [normal, tangent, cross(normal, tangent)] if tangent else [normal]
        return [(axis, turns) for turns in (False, True) for axis in frame][: self.kind.num_directions]

    @cached_property
    def sides(self) -> list[Side]:
        arms, columns = self.read("arms"), zip(self.kind.bodies, self.kind.signs, strict=True)
        return [
            Side(bodies.at(self.contact), sign, arms[3 * k : 3 * k + 3])
            for k, (bodies, sign) in enumerate(columns)
        ]

    @cached_property
    def law(self) -> Law:
        friction = [one.at(self.contact) for one in self.kind.friction]
        return law_of(self.kind.first, friction, self.read("stiffness")[0])

    @property
    def touches(self) -> Number:
        """Whether the geoms are so near that MuJoCo counts the contact."""
        return self.read("distance")[0] < self.kind.reach.at(self.contact)

    def arm(self, side: Place) -> Vector:
        """The arm of a side that the running program chooses."""
        flat = Array(self.kind.program, self.kind.numbers.first, 1)
        first = self.row * self.kind.numbers.width + side * 3 + self.kind.range_of("arms").start
        return [flat.row(first + k)[0] for k in range(3)]

    def read(self, name: str) -> Vector:
        return self.kind.numbers.read(self.row, self.kind.range_of(name))

    def store(self, name: str, values: Sequence[Number]) -> None:
        self.kind.numbers.store(self.row, values, self.kind.range_of(name).start)
