"""A program's operations as LLVM's instructions, on numbers of an environment or of several in a vector.

Source: LLVM's language reference. Products and sums may be fused, and nothing is reordered: an environment's
numbers do not depend on its neighbours.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from mujoco_compiled.code.angles import reduced, turn
from mujoco_compiled.code.lines import Lines
from mujoco_compiled.code.spaces import place_of, read, store
from mujoco_compiled.code.steps import Step, Write, num_operations
from mujoco_compiled.code.target import Barrier, Target
from mujoco_compiled.program.program import (
    Assign,
    Branch,
    Call,
    Each,
    Loop,
    Operation,
    Program,
    Read,
    Store,
    Together,
)

_INSTRUCTIONS: Mapping[Operation, str] = {
    "add": "fadd contract",
    "subtract": "fsub contract",
    "multiply": "fmul contract",
    "negate": "fneg",
}


class Memory(Protocol):
    """Where inputs and outputs are, and how lanes meet. places, values: by lane, or one for all lanes."""

    def load(self, writer: "Writer", target: str, name: str, places: Sequence[int]) -> None: ...

    def store(self, writer: "Writer", name: str, places: Sequence[int], value: str) -> None: ...

    def lane_constant(self, writer: "Writer", target: str, values: Sequence[float]) -> None: ...

    def lane_sum(self, writer: "Writer", target: str, value: str) -> None: ...


@dataclass
class Writer(Lines):
    """The body of a function. block: the label of the block that is being written. routines: of the program,
    by their numbers."""

    memory: Memory
    block: str
    routines: Sequence[str] = ()
    _num_since_barrier: int = 0
    _num_alone: int = 0  # parts around the block through which a thread goes alone
    # By the name of an angle: sine and cosine of what is left of it, and its quadrant.
    _angles: dict[str, tuple[str, str, str]] = field(default_factory=dict[str, tuple[str, str, str]])

    def begin_block(self, label: str) -> None:
        """The block that follows this one."""
        self.line(f"br label %{label}")
        self.lines.append(f"{label}:")
        self.block = label

    def write(self, steps: Sequence[Step]) -> None:
        for step in steps:
            self._meet_before(step)
            self._step(step)

    def _step(self, step: Step) -> None:
        match step:
            case Loop():
                self._loop(step)
            case Branch():
                self._branch(step)
            case Write():
                self.memory.store(self, step.output, step.places, self.operand(step.variable))
            case Assign():
                self._assign(step)
            case Read():
                read(self, step)
            case Store():
                store(self, step)
            case Each():
                self._each(step)
            case Together():
                self._together(step)
            case Call():
                self._call(step)

    def _meet_before(self, step: Step) -> None:
        if self.target.barrier is None:
            return
        self._num_since_barrier += num_operations([step])
        if self._barrier is not None and self._num_since_barrier > self._barrier.every:
            self.line(self._barrier.wait)
            self._num_since_barrier = 0

    @property
    def _barrier(self) -> Barrier | None:
        return None if self._num_alone else self.target.barrier

    def _assign(self, statement: Assign) -> None:
        target, operation, arguments = f"%v{statement.target}", statement.operation, statement.arguments
        match operation:
            case "input" | "lane_input":
                name, *places = arguments
                self.memory.load(self, target, str(name), [int(place) for place in places])
            case "lane_constant":
                self.memory.lane_constant(self, target, [float(value) for value in arguments])
            case "lane_sum":
                self.memory.lane_sum(self, target, self.operand(arguments[0]))
            case "constant":
                self._constants[statement.target] = self.target.constant(float(arguments[0]))
            case "minimum" | "maximum" | "less" | "and" | "not" | "select":
                self._choose(target, operation, [self.operand(one) for one in arguments])
            case _:
                self._compute(target, operation, [self.operand(one) for one in arguments])

    def _compute(self, target: str, operation: Operation, names: list[str]) -> None:
        number, suffix, allowed = self.target.number, self.target.suffix, self.target.allowed
        match operation:
            case "divide":
                self.line(f"{target} = fdiv {allowed} {number} {names[0]}, {names[1]}")
            case "sqrt":
                self.line(f"{target} = call {allowed} {number} @llvm.sqrt.{suffix}({number} {names[0]})")
            case "absolute":
                self.line(f"{target} = call {number} @llvm.fabs.{suffix}({number} {names[0]})")
            case "sin" | "cos":
                self._turn(target, operation, names[0])
            case "truncate":
                whole = self.value(f"fptosi {number} {names[0]} to {self.target.integer}")
                self.line(f"{target} = sitofp {self.target.integer} {whole} to {number}")
            case _:
                self.line(f"{target} = {_INSTRUCTIONS[operation]} {number} {', '.join(names)}")

    def _choose(self, target: str, operation: Operation, names: list[str]) -> None:
        number, truth = self.target.number, self.target.truth
        match operation:
            case "less":
                self.line(f"{target} = fcmp olt {number} {names[0]}, {names[1]}")
            case "and":
                self.line(f"{target} = and {truth} {names[0]}, {names[1]}")
            case "not":
                self.line(f"{target} = xor {truth} {names[0]}, {self.target.splat('i1', 'true')}")
            case "select":
                self.select(target, *names)
            case _:
                order = "olt" if operation == "minimum" else "ogt"
                is_first = self.value(f"fcmp {order} {number} {names[0]}, {names[1]}")
                self.select(target, is_first, names[0], names[1])

    def _turn(self, target: str, operation: Operation, angle: str) -> None:
        if angle not in self._angles:
            self._angles[angle] = reduced(self, angle)
        turn(self, target, operation, self._angles[angle])

    def _loop(self, loop: Loop) -> None:
        head, inside, after = (self.name()[1:] for _ in range(3))
        count, next_count, running, next_running = (self.name() for _ in range(4))
        begun, truth = self.block, self.target.truth
        known = dict(self._angles)
        barrier = self._barrier
        alone = barrier is not None and num_operations(loop.body) <= barrier.every
        self._num_alone += alone
        self.line(f"br label %{head}")
        self.lines.append(f"{head}:")
        place = len(self.lines)  # of the phis, which need the last block of the body
        # All threads of a team call a routine together: those that are done wait for the others.
        team = self.target.team if _calls(loop.body) else None
        any_runs = self.value(f"{team.any} {running})") if team else self._any_runs(running)
        is_left = self.value(f"icmp slt i32 {count}, {loop.most}")
        goes_on = self.value(f"and i1 {any_runs}, {is_left}")
        self.line(f"br i1 {goes_on}, label %{inside}, label %{after}")
        self.lines.append(f"{inside}:")
        self.block = inside
        self.write(loop.body)
        kept = dict[int, str]()
        for variable, _, value in loop.carried:
            kept[variable] = self.operand(value)
            if loop.improves is not None and (self._goes_on_for_others or team):
                kept[variable] = self.name()
                self.select(kept[variable], running, self.operand(value), f"%v{variable}")
        true = self.target.splat("i1", "true")
        improves = true if loop.improves is None else f"%v{loop.improves}"
        self.line(f"{next_running} = and {truth} {running}, {improves}")
        self.line(f"{next_count} = add i32 {count}, 1")
        self.line(f"br label %{head}")
        last = self.block
        self.lines[place:place] = [
            f"  {count} = phi i32 [ 0, %{begun} ], [ {next_count}, %{last} ]",
            f"  {running} = phi {truth} [ {true}, %{begun} ], [ {next_running}, %{last} ]",
            *(
                f"  %v{variable} = phi {self.target.number} "
                f"[ {self.operand(before)}, %{begun} ], [ {kept[variable]}, %{last} ]"
                for variable, before, _ in loop.carried
            ),
        ]
        self.lines.append(f"{after}:")
        self.block, self._angles = after, known
        self._num_alone -= alone

    def _branch(self, branch: Branch) -> None:
        self._refuse_calls(branch)
        inside, after = self.name()[1:], self.name()[1:]
        condition, begun = self.operand(branch.condition), self.block
        known = dict(self._angles)
        self.line(f"br i1 {self.any(condition)}, label %{inside}, label %{after}")
        self.lines.append(f"{inside}:")
        self.block = inside
        self._num_alone += 1
        self.write(branch.body)
        self._num_alone -= 1
        found = dict[int, str]()
        for variable, value, otherwise in branch.results:
            found[variable] = self.operand(value)
            if self.target.width > 1:
                found[variable] = self.name()
                self.select(found[variable], condition, self.operand(value), self.operand(otherwise))
        self.line(f"br label %{after}")
        self.lines.append(f"{after}:")
        for variable, _, otherwise in branch.results:
            self.line(
                f"%v{variable} = phi {self.target.number} "
                f"[ {found[variable]}, %{self.block} ], [ {self.operand(otherwise)}, %{begun} ]"
            )
        self.block, self._angles = after, known

    def _each(self, each: Each) -> None:
        self._refuse_calls(each)
        head, inside, after = (self.name()[1:] for _ in range(3))
        counter, next_count = f"%v{each.counter}", self.name()
        team = self.target.team if each.is_parted else None
        first, stride = ("%part", "%num_parts") if team else ("0", "1")
        begun, known, count = self.block, dict(self._angles), place_of(self, each.count)
        self._num_alone += 1
        self.line(f"br label %{head}")
        self.lines.append(f"{head}:")
        place = len(self.lines)  # of the phis, which need the last block of the body
        is_left = self.value(f"icmp slt i64 {counter}, {count}")
        self.line(f"br i1 {is_left}, label %{inside}, label %{after}")
        self.lines.append(f"{inside}:")
        self.block = inside
        self.write(each.body)
        self.line(f"{next_count} = add nsw i64 {counter}, {stride}")
        self.line(f"br label %{head}")
        last = self.block
        self.lines[place:place] = [
            f"  {counter} = phi i64 [ {first}, %{begun} ], [ {next_count}, %{last} ]",
            *(
                f"  %v{variable} = phi {self.target.number} "
                f"[ {self.operand(first)}, %{begun} ], [ {self.operand(value)}, %{last} ]"
                for variable, first, value in each.carried
            ),
        ]
        self.lines.append(f"{after}:")
        self.block, self._angles = after, known
        self._num_alone -= 1
        if team and each.meets:
            self.line(team.wait)

    def _refuse_calls(self, step: Branch | Each | Together) -> None:
        """Raises ValueError where a team's threads would wait for some that do not come."""
        if self.target.team and _calls(step.body):
            raise ValueError("A routine is called where threads go their own ways.")

    def _call(self, call: Call) -> None:
        """The other threads of a team wait for the routine's number."""
        team, name = self.target.team, routine_name(call.routine)
        if team is None:
            self.line(f"call void {name}({seen(self.target)})")
            return
        self.line(f"{team.begin} {self.routines.index(call.routine)})")
        self.line(f"call void {name}({seen(self.target)}, i64 0, i64 %num_parts)")

    def _together(self, together: Together) -> None:
        self._refuse_calls(together)
        inside, after = self.name()[1:], self.name()[1:]
        known, condition = dict(self._angles), self.operand(together.condition)
        self.line(f"br i1 {self.any(condition)}, label %{inside}, label %{after}")
        self.lines.append(f"{inside}:")
        self.block = inside
        self._num_alone += 1
        self.write(together.body)
        self._num_alone -= 1
        self.begin_block(after)
        self._angles = known

    @property
    def _goes_on_for_others(self) -> bool:
        """Whether an environment stays in a loop while others run."""
        return self.target.width > 1 or self._barrier is not None

    def _any_runs(self, running: str) -> str:
        """Whether any of the environments that go through a loop together still runs."""
        if self._barrier is None:
            return self.any(running)
        return self.value(f"{self._barrier.any}(i32 0, i1 {running})")


def routines(program: Program, target: Target, memory: Memory) -> list[str]:
    """The routines as functions of what they see, and with a team of which thread this is and of how many."""
    parameters = seen(target) + (", i64 %part, i64 %num_parts" if target.team else "")
    lines = list[str]()
    for name, body in program.routines.items():
        writer = Writer(target, memory, block="body")
        writer.write(body)
        if target.team:
            writer.line(target.team.wait)
        head = f"define internal void {routine_name(name)}({parameters}) noinline nounwind {{"
        lines += [head, "body:", *writer.lines, "  ret void", "}"]
    return lines


def seen(target: Target) -> str:
    """Pointers to the spaces that routines see."""
    return f"{target.shared} %shared, {target.common} %common"


def routine_name(routine: str) -> str:
    """The function's."""
    return f'@"routine: {routine}"'


def _calls(body: Sequence[Step]) -> bool:
    """Whether a routine is called in it."""
    return any(
        isinstance(one, Call) or (isinstance(one, Loop | Branch | Each | Together) and _calls(one.body))
        for one in body
    )
