"""The parts that operations of alike limbs share."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field

from mujoco_compiled.program.program import Operation

TRUNK = -1


@dataclass(frozen=True)
class Kind:
    """lane: of the limb that a number belongs to, or TRUNK. form: equal for numbers of alike limbs that are
    computed alike, up to their sign."""

    lane: int
    form: int
    sign: int = 1

    @property
    def signed(self) -> tuple[int, int]:
        return self.form, self.sign


@dataclass
class Forms:
    """Numbers for what was seen: descriptions of descriptions would grow with the program."""

    _numbers: dict[Hashable, int] = field(default_factory=dict[Hashable, int])

    def number(self, *described: Hashable) -> int:
        return self._numbers.setdefault(described, len(self._numbers))

    def kind(self, lane: int, operation: Operation, arguments: Sequence[Kind]) -> Kind:
        """The result's kind. Signs are kept apart: whether a program adds or subtracts depends
        on the order in which it was written."""
        forms = [one.form for one in arguments]
        sign = 1
        for one in arguments:
            sign *= one.sign
        match operation:
            case "add" | "subtract":
                return self._sum(lane, operation, arguments)
            case "multiply":
                return Kind(lane, self.number("multiply", *sorted(forms)), sign)
            case "divide":
                return Kind(lane, self.number("divide", *forms), sign)
            case "negate":
                return Kind(lane, forms[0], -sign)
            case "sin":
                return Kind(lane, self.number("sin", *forms), sign)
            case "cos" | "absolute":
                return Kind(lane, self.number(operation, *forms))
            case "and":
                return Kind(lane, self.number("and", *sorted(forms)))
            case _:
                return Kind(lane, self.number(operation, *(one.signed for one in arguments)))

    def _sum(self, lane: int, operation: Operation, arguments: Sequence[Kind]) -> Kind:
        one, other = arguments
        second = -other.sign if operation == "subtract" else other.sign
        terms = sorted([(one.form, one.sign), (other.form, second)])
        signs = terms[0][1], terms[1][1]
        return Kind(lane, self.number("add", terms[0][0], terms[1][0], signs[0] * signs[1]), signs[0])
