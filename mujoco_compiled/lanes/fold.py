"""A body's program with a limb in each lane: the operations of alike limbs are written once.

Each operation belongs to the trunk, which every lane computes for itself, or to a limb. Limbs are compared
operation by operation, from the inputs on, and nothing but equal programs is folded. Where limbs meet, their
numbers must be summed: one limb's terms first, and then over the lanes.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from mujoco_compiled.lanes.forms import TRUNK, Forms, Kind
from mujoco_compiled.lanes.lane_constants import NotAlike
from mujoco_compiled.program.arithmetic import select, total
from mujoco_compiled.program.flow import needed
from mujoco_compiled.program.program import (
    Assign,
    Branch,
    Loop,
    Output,
    Program,
    Statement,
    Symbol,
    assigns,
)

# Numbers of inputs that are alike, by input: their places by lane.
Alike = Mapping[str, Sequence[tuple[int, ...]]]
_GIVEN = ("constant", "input", "limb_constant")
_MEETING = ("add", "subtract", "and")
# Variables with their signs, of a sum, or of conditions that must all hold.
_Terms = tuple[tuple[int, int], ...]


def folded(program: Program, alike: Alike, num_lanes: int) -> Program:
    """The program for several lanes. Raises NotAlike where limbs do not do the same."""
    return needed(_Fold(program, alike, num_lanes).written())


@dataclass
class _Fold:
    """symbols: of the new program, by the trunk's variables and the first limb's. meetings: by variable, the
    terms of several limbs that do not end here."""

    source: Program
    alike: Alike
    num_lanes: int
    program: Program = field(default_factory=Program)
    forms: Forms = field(default_factory=Forms)
    kinds: dict[int, Kind] = field(default_factory=dict[int, Kind])
    symbols: dict[int, Symbol] = field(default_factory=dict[int, Symbol])
    meetings: dict[int, _Terms] = field(default_factory=dict[int, _Terms])
    sums: dict[int, Assign] = field(default_factory=dict[int, Assign])
    uses: dict[int, list[Assign | None]] = field(default_factory=dict[int, list[Assign | None]])

    def written(self) -> Program:
        self.program.num_lanes = self.num_lanes
        self._note_uses(self.source.statements)
        for outputs in self.source.outputs.values():
            for output in outputs:
                self.uses.setdefault(output.variable, []).append(None)
        self._take(self.source.statements)
        for name, outputs in self.source.outputs.items():
            self.program.outputs[name] = list(self._outputs(name, outputs))
        return self.program

    def _note_uses(self, statements: Sequence[Statement]) -> None:
        for one in statements:
            if isinstance(one, Loop):
                used = [variable for _, before, after in one.carried for variable in (before, after)]
                for variable in [*used, *([] if one.improves is None else [one.improves])]:
                    self.uses.setdefault(variable, []).append(None)
                self._note_uses(one.body)
            elif isinstance(one, Branch):
                for variable in (one.condition, *(x for _, *both in one.results for x in both)):
                    self.uses.setdefault(variable, []).append(None)
                self._note_uses(one.body)
            elif isinstance(one, Assign):
                for variable in one.uses:
                    self.uses.setdefault(variable, []).append(one)

    def _take(self, statements: Sequence[Statement]) -> None:
        here = {one.target for one in statements if isinstance(one, Assign)}
        for one in statements:
            if isinstance(one, Loop):
                self._take_loop(one)
            elif isinstance(one, Branch):
                self._take_branch(one)
            elif not isinstance(one, Assign):
                raise AssertionError("A program with contacts in slots is not shared out to lanes.")
            elif one.operation in _GIVEN:
                self._take_given(one)
            else:
                self._take_operation(one, here)

    def _take_given(self, one: Assign) -> None:
        match one.operation:
            case "limb_constant":
                lane, values = int(one.arguments[0]), one.arguments[1:]
                self._limb(one.target, lane, self.forms.number("constant", *values))
                if lane == 0:
                    self.symbols[one.target] = self.program.write("lane_constant", *values)
            case "input":
                self._take_input(one.target, str(one.arguments[0]), int(one.arguments[1]))
            case _:
                kind = Kind(TRUNK, self.forms.number("constant", *one.arguments))
                self._trunk(one.target, self.program.write(one.operation, *one.arguments), kind)

    def _take_input(self, target: int, name: str, place: int) -> None:
        places = next((places for places in self.alike.get(name, ()) if place in places), None)
        if places is None:
            self._trunk(target, self.program.write("input", name, place))
            return
        self._limb(target, places.index(place), self.forms.number("input", name, places))
        if place == places[0]:
            self.symbols[target] = self.program.write("lane_input", name, *places)

    def _take_operation(self, one: Assign, here: set[int]) -> None:
        numbers = [int(argument) for argument in one.arguments]
        lanes = {self.kinds[number].lane for number in numbers if number in self.kinds} - {TRUNK}
        if len(lanes) > 1 or any(number in self.meetings for number in numbers):
            self._meet(one, here)
            return
        if one.operation in _MEETING:
            self.sums[one.target] = one
        lane = lanes.pop() if lanes else TRUNK
        kind = self.forms.kind(lane, one.operation, [self.kinds[x] for x in numbers])
        if lane == TRUNK:
            self._trunk(one.target, self._symbol(one), kind)
            return
        self.kinds[one.target] = kind
        if lane == 0:
            self.symbols[one.target] = self._symbol(one)

    def _meet(self, one: Assign, here: set[int]) -> None:
        """A sum over limbs, or a part of one."""
        if one.operation not in _MEETING:
            raise NotAlike(f"limbs meet in an operation, `{one.operation}`, that is no sum")
        terms = tuple(self._terms_of(one))
        if not self._is_complete(terms) or self._goes_on(one, here):
            self.meetings[one.target] = terms
            return
        summed = self._all_hold(terms) if one.operation == "and" else self._summed(terms)
        self._trunk(one.target, summed)

    def _terms_of(self, one: Assign) -> Iterator[tuple[int, int]]:
        """A sum's terms, down to those that something else needs, too."""
        first, second = (int(argument) for argument in one.arguments)
        yield from self._terms(first, one)
        for sign, variable in self._terms(second, one):
            yield (-sign if one.operation == "subtract" else sign), variable

    def _terms(self, variable: int, of: Assign) -> Iterator[tuple[int, int]]:
        inner = self.sums.get(variable)
        if variable in self.meetings:
            yield from self.meetings[variable]
        elif (
            inner is not None
            and self.kinds[variable].lane != TRUNK
            and len(self.uses[variable]) == 1
            and (inner.operation == "and") == (of.operation == "and")
        ):
            yield from self._terms_of(inner)
        else:
            yield 1, variable

    def _is_complete(self, terms: _Terms) -> bool:
        """Whether all limbs have the same terms."""
        by_lane = [Counter[tuple[int, int]]() for _ in range(self.num_lanes)]
        for sign, variable in terms:
            kind = self._kind_of(variable)
            if kind.lane != TRUNK:
                by_lane[kind.lane][kind.form, kind.sign * sign] += 1
        return all(one == by_lane[0] for one in by_lane)

    def _goes_on(self, one: Assign, here: set[int]) -> bool:
        """Whether the only use is in another sum of this block, which may bring more terms of limbs."""
        uses = self.uses.get(one.target, [])
        following = uses[0] if len(uses) == 1 else None
        if following is None or following.target not in here or following.operation not in _MEETING:
            return False
        return (following.operation == "and") == (one.operation == "and")

    def _summed(self, terms: _Terms) -> Symbol:
        """The trunk's terms, and the sum over the lanes of the first limb's."""
        trunk, limb = self._parted(terms)
        return self._as_symbol(total([*trunk, self._over_lanes(total(limb))]))

    def _all_hold(self, terms: _Terms) -> Symbol:
        trunk, limb = self._parted(terms)
        found = self._over_lanes(total(select(one, 0.0, 1.0) for one in limb)) < 0.5
        for one in trunk:
            found = found & one
        return found

    def _parted(self, terms: _Terms) -> tuple[list[Symbol], list[Symbol]]:
        """The trunk's, and the first limb's."""
        found: dict[int, list[Symbol]] = {TRUNK: [], 0: []}
        for sign, variable in terms:
            lane = self.kinds[variable].lane
            if lane in found:
                symbol = self.symbols[variable]
                found[lane].append(symbol if sign > 0 else -symbol)
        return found[TRUNK], found[0]

    def _over_lanes(self, value: Symbol | float) -> Symbol:
        return self.program.write("lane_sum", self.program.variable(value))

    def _symbol(self, one: Assign) -> Symbol:
        """The operation, written into the new program."""
        symbols = [self.symbols[int(number)] for number in one.arguments]
        match one.operation:
            case "add":
                return self._as_symbol(symbols[0] + symbols[1])
            case "subtract":
                return self._as_symbol(symbols[0] - symbols[1])
            case "multiply":
                return self._as_symbol(symbols[0] * symbols[1])
            case "divide":
                return self._as_symbol(symbols[0] / symbols[1])
            case "negate":
                return -symbols[0]
            case _:
                numbers = [self.program.variable(symbol) for symbol in symbols]
                return self.program.write(one.operation, *numbers)

    def _as_symbol(self, value: Symbol | float) -> Symbol:
        return value if isinstance(value, Symbol) else self.program.write("constant", value)

    def _take_loop(self, loop: Loop) -> None:
        self._begin(loop)
        written = [entry for entry in loop.carried if self.kinds[entry[0]].lane in (TRUNK, 0)]
        before = {entry[0]: self.program.variable(self.symbols[entry[1]]) for entry in written}
        for variable, _, _ in written:
            self.symbols[variable] = Symbol(self.program, self.program.new_variable())
        with self.program.block() as statements:
            self._take(loop.body)
            self._end(loop)
            written = [entry for entry in written if self.kinds[entry[0]].lane in (TRUNK, 0)]
            after = {entry[0]: self.program.variable(self.symbols[entry[2]]) for entry in written}
            improves = None
            if loop.improves is not None:
                if self._kind_of(loop.improves).lane != TRUNK:
                    raise NotAlike("limbs decide for themselves when to stop")
                improves = self.program.variable(self.symbols[loop.improves])
        carried = tuple((self.symbols[one].number, before[one], after[one]) for one, _, _ in written)
        self.program.statements.append(Loop(loop.most, carried, tuple(statements), improves))

    def _take_branch(self, branch: Branch) -> None:
        """Results are alike where a choice among the same numbers would be."""
        condition = self._kind_of(branch.condition)
        with self.program.block() as statements:
            self._take(branch.body)
            if condition.lane != TRUNK and any(one.operation == "lane_sum" for one in assigns(statements)):
                raise NotAlike("limbs meet where only some of them compute")
            insides = {
                one: self.program.variable(self.symbols[one])
                for _, one, _ in branch.results
                if self._kind_of(one).lane in (TRUNK, 0)
            }
        results = list[tuple[int, int, int]]()
        for variable, inside, otherwise in branch.results:
            kinds = [condition, self._kind_of(inside), self._kind_of(otherwise)]
            lanes = {kind.lane for kind in kinds} - {TRUNK}
            if len(lanes) > 1:
                raise NotAlike("limbs meet in a choice")
            lane = lanes.pop() if lanes else TRUNK
            self.kinds[variable] = self.forms.kind(lane, "select", kinds)
            if lane in (TRUNK, 0):
                self.symbols[variable] = Symbol(self.program, self.program.new_variable())
                outside = self.program.variable(self.symbols[otherwise])
                results.append((self.symbols[variable].number, insides[inside], outside))
        if results:
            number = self.program.variable(self.symbols[branch.condition])
            self.program.statements.append(Branch(number, tuple(statements), tuple(results)))

    def _begin(self, loop: Loop) -> None:
        """The loop's variables are alike where what they begin with is."""
        counts = Counter[tuple[int, ...]]()
        for variable, before, _ in loop.carried:
            kind = self._kind_of(before)
            if kind.lane == TRUNK:
                self.kinds[variable] = Kind(TRUNK, self.forms.number("trunk", variable))
                continue
            counts[kind.lane, *kind.signed] += 1
            described = loop.carried[0][0], kind.signed, counts[kind.lane, *kind.signed]
            self._limb(variable, kind.lane, self.forms.number("carried", *described))

    def _end(self, loop: Loop) -> None:
        """The steps after a repetition must be alike where the variables are."""
        ends: dict[int, tuple[int, int]] = {}
        inside = {one.target for one in assigns(loop.body)}
        for variable, _, after in loop.carried:
            kind, end = self.kinds[variable], self._kind_of(after)
            if kind.lane == TRUNK and end.lane != TRUNK:
                if any(one is not None and one.target in inside for one in self.uses.get(variable, [])):
                    raise NotAlike("a number of the trunk becomes a limb's")
                # It begins as a constant and is only written.
                self._limb(variable, end.lane, self.forms.number("ended", loop.carried[0][0], end.signed))
            elif kind.lane != TRUNK and (
                end.lane not in (TRUNK, kind.lane) or ends.setdefault(kind.form, end.signed) != end.signed
            ):
                raise NotAlike("limbs repeat different operations")

    def _outputs(self, name: str, outputs: Sequence[Output]) -> Iterator[Output]:
        """One for all lanes where limbs write what is alike."""
        places: dict[tuple[int, int], list[list[int]]] = {}
        variables: dict[tuple[int, int], list[int]] = {}
        for output in outputs:
            kind = self._kind_of(output.variable)
            if kind.lane == TRUNK:
                yield Output(self.program.variable(self.symbols[output.variable]), output.places)
                continue
            places.setdefault(kind.signed, [[] for _ in range(self.num_lanes)])[kind.lane] += output.places
            if kind.lane == 0:
                variable = self.program.variable(self.symbols[output.variable])
                variables.setdefault(kind.signed, []).append(variable)
        for signed, by_lane in places.items():
            if len({len(own) for own in by_lane}) > 1:
                raise NotAlike(f"limbs write different parts of {name}")
            for variable, *own in zip(variables[signed], *by_lane, strict=True):
                yield Output(variable, tuple(own))

    def _kind_of(self, variable: int) -> Kind:
        if variable not in self.kinds:
            raise NotAlike("a sum over some of the limbs is needed")
        return self.kinds[variable]

    def _trunk(self, variable: int, symbol: Symbol, kind: Kind | None = None) -> None:
        self.kinds[variable] = kind or Kind(TRUNK, self.forms.number("trunk", variable))
        self.symbols[variable] = symbol

    def _limb(self, variable: int, lane: int, form: int) -> None:
        self.kinds[variable] = Kind(lane, form)
