"""From a program to LLVM's language, with an environment in each lane of a vector.

Source: LLVM's language reference. Multiplications and additions may be fused, and nothing else is reordered:
an environment's numbers do not depend on its neighbours.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from core.physics.compiled.program import Assign, Loop, Operation, Program, Statement

# By LLVM's names.
_INSTRUCTIONS: Mapping[Operation, str] = {
    "add": "fadd contract",
    "subtract": "fsub contract",
    "multiply": "fmul contract",
    "divide": "fdiv",
    "negate": "fneg",
}
_FUNCTIONS: Mapping[Operation, str] = {"sqrt": "sqrt", "sin": "sin", "cos": "cos", "absolute": "fabs"}


@dataclass
class Writer:
    """The body of a function on vectors of `width` float32.

    sizes: how many numbers of an environment each array holds. block: the label of the block that is being
    written.
    """

    width: int
    sizes: Mapping[str, int]
    lines: list[str] = field(default_factory=list[str])
    block: str = "group"
    _num_names: int = 0

    @property
    def number(self) -> str:
        return f"<{self.width} x float>"

    @property
    def truth(self) -> str:
        return f"<{self.width} x i1>"

    def name(self) -> str:
        self._num_names += 1
        return f"%t{self._num_names}"

    def line(self, text: str) -> None:
        self.lines.append(f"  {text}")

    def write(self, statements: Sequence[Statement]) -> None:
        for statement in statements:
            if isinstance(statement, Loop):
                self._loop(statement)
            else:
                self._assign(statement)

    def _assign(self, statement: Assign) -> None:
        target, operation, arguments = f"%v{statement.target}", statement.operation, statement.arguments
        match operation:
            case "input":
                self._load(target, str(arguments[0]), int(arguments[1]))
            case "constant":
                self._constant(target, float(arguments[0]))
            case "minimum" | "maximum" | "less" | "and" | "not" | "select":
                self._choose(target, operation, [f"%v{argument}" for argument in arguments])
            case _:
                self._compute(target, operation, [f"%v{argument}" for argument in arguments])

    def _compute(self, target: str, operation: Operation, names: list[str]) -> None:
        if operation in _INSTRUCTIONS:
            self.line(f"{target} = {_INSTRUCTIONS[operation]} {self.number} {', '.join(names)}")
        else:
            function = f"@llvm.{_FUNCTIONS[operation]}.v{self.width}f32"
            self.line(f"{target} = call {self.number} {function}({self.number} {names[0]})")

    def _choose(self, target: str, operation: Operation, names: list[str]) -> None:
        match operation:
            case "less":
                self.line(f"{target} = fcmp olt {self.number} {names[0]}, {names[1]}")
            case "and":
                self.line(f"{target} = and {self.truth} {names[0]}, {names[1]}")
            case "not":
                self.line(f"{target} = xor {self.truth} {names[0]}, splat (i1 true)")
            case "select":
                self._select(target, *names)
            case _:
                is_first = self.name()
                order = "olt" if operation == "minimum" else "ogt"
                self.line(f"{is_first} = fcmp {order} {self.number} {names[0]}, {names[1]}")
                self._select(target, is_first, names[0], names[1])

    def _constant(self, target: str, value: float) -> None:
        # LLVM writes a float32 as the bits of the equal float64; `bitcast` gives a constant a name.
        bits = np.float64(np.float32(value)).view(np.uint64)
        self.line(f"{target} = bitcast {self.number} splat (float 0x{bits:016X}) to {self.number}")

    def _select(self, target: str, condition: str, chosen: str, otherwise: str) -> None:
        self.line(
            f"{target} = select {self.truth} {condition}, {self.number} {chosen}, {self.number} {otherwise}"
        )

    def _load(self, target: str, name: str, place: int) -> None:
        pointers = self._pointers(name, place)
        gather = f"@llvm.masked.gather.v{self.width}f32.v{self.width}p0"
        self.line(
            f"{target} = call {self.number} {gather}(<{self.width} x ptr> {pointers}, i32 4, "
            f"{self.truth} %exists, {self.number} zeroinitializer)"
        )

    def store(self, name: str, place: int, variable: int) -> None:
        pointers = self._pointers(name, place)
        scatter = f"@llvm.masked.scatter.v{self.width}f32.v{self.width}p0"
        self.line(
            f"call void {scatter}({self.number} %v{variable}, <{self.width} x ptr> {pointers}, i32 4, "
            f"{self.truth} %exists)"
        )

    def _pointers(self, name: str, place: int) -> str:
        """Where each lane's environment has this number of an array [environments, size]."""
        first, pointers = self.name(), self.name()
        self.line(f"{first} = getelementptr float, ptr %{name}, i64 {place}")
        self.line(
            f"{pointers} = getelementptr [{self.sizes[name]} x float], ptr {first}, "
            f"<{self.width} x i64> %environments"
        )
        return pointers

    def _loop(self, loop: Loop) -> None:
        head, inside, after = (self.name()[1:] for _ in range(3))
        count, next_count, running, next_running = (self.name() for _ in range(4))
        begun = self.block
        self.line(f"br label %{head}")
        self.lines.append(f"{head}:")
        place = len(self.lines)  # of the phis, which need the last block of the body
        any_runs, is_left, goes_on = (self.name() for _ in range(3))
        reduce = f"@llvm.vector.reduce.or.v{self.width}i1"
        self.line(f"{any_runs} = call i1 {reduce}({self.truth} {running})")
        self.line(f"{is_left} = icmp slt i32 {count}, {loop.most}")
        self.line(f"{goes_on} = and i1 {any_runs}, {is_left}")
        self.line(f"br i1 {goes_on}, label %{inside}, label %{after}")
        self.lines.append(f"{inside}:")
        self.block = inside
        self.write(loop.body)
        kept = dict[int, str]()
        for variable, _, value in loop.carried:
            kept[variable] = self.name()
            self._select(kept[variable], running, f"%v{value}", f"%v{variable}")
        improves = "splat (i1 true)" if loop.improves is None else f"%v{loop.improves}"
        self.line(f"{next_running} = and {self.truth} {running}, {improves}")
        self.line(f"{next_count} = add i32 {count}, 1")
        self.line(f"br label %{head}")
        last = self.block
        phis = [
            f"  {count} = phi i32 [ 0, %{begun} ], [ {next_count}, %{last} ]",
            f"  {running} = phi {self.truth} [ splat (i1 true), %{begun} ], [ {next_running}, %{last} ]",
            *(
                f"  %v{variable} = phi {self.number} [ %v{before}, %{begun} ], [ {kept[variable]}, %{last} ]"
                for variable, before, _ in loop.carried
            ),
        ]
        self.lines[place:place] = phis
        self.lines.append(f"{after}:")
        self.block = after


def function(program: Program, name: str, width: int) -> str:
    """A module with `void name(i64 first, i64 end, inputs..., outputs...)`, in the program's order.

    It moves the environments from first to end - 1. An input or output is a pointer to float32
    [environments, size].
    """
    sizes = _sizes(program)
    writer = Writer(width, sizes)
    writer.write(program.statements)
    for output, variables in program.outputs.items():
        for place, variable in enumerate(variables):
            writer.store(f"to_{output}", place, variable)
    number, truth, lanes = writer.number, writer.truth, f"<{width} x i64>"
    pointers = f"<{width} x ptr>"
    order = ", ".join(f"i64 {lane}" for lane in range(width))
    arrays = ", ".join(f"ptr noalias %{one}" for one in sizes)
    kind = f"v{width}f32.v{width}p0"
    return "\n".join(
        [
            *(f"declare {number} @llvm.{one}.v{width}f32({number})" for one in _FUNCTIONS.values()),
            f"declare i1 @llvm.vector.reduce.or.v{width}i1({truth})",
            f"declare {number} @llvm.masked.gather.{kind}({pointers}, i32, {truth}, {number})",
            f"declare void @llvm.masked.scatter.{kind}({number}, {pointers}, i32, {truth})",
            f"define void @{name}(i64 %first, i64 %end, {arrays}) {{",
            "entry:",
            f"  %ends = insertelement {lanes} poison, i64 %end, i64 0",
            f"  %limit = shufflevector {lanes} %ends, {lanes} poison, <{width} x i32> zeroinitializer",
            "  br label %next",
            "next:",
            f"  %begin = phi i64 [ %first, %entry ], [ %following, %{writer.block} ]",
            "  %is_left = icmp slt i64 %begin, %end",
            "  br i1 %is_left, label %group, label %done",
            "group:",
            f"  %begins = insertelement {lanes} poison, i64 %begin, i64 0",
            f"  %all = shufflevector {lanes} %begins, {lanes} poison, <{width} x i32> zeroinitializer",
            f"  %environments = add {lanes} %all, <{order}>",
            f"  %exists = icmp slt {lanes} %environments, %limit",
            *writer.lines,
            f"  %following = add i64 %begin, {width}",
            "  br label %next",
            "done:",
            "  ret void",
            "}",
            "",
        ]
    )


def _sizes(program: Program) -> dict[str, int]:
    """The numbers of each input and output, in the order of the function's pointers."""
    sizes = dict[str, int]()
    for one in program.statements:
        if isinstance(one, Assign) and one.operation == "input":
            name, place = str(one.arguments[0]), int(one.arguments[1])
            sizes[name] = max(sizes.get(name, 0), place + 1)
    return sizes | {f"to_{name}": len(variables) for name, variables in program.outputs.items()}
