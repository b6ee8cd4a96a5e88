"""A long program as many functions, each with a section of it, and one that calls them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from mujoco_compiled.code.slots import (
    LongBranch,
    LongLoop,
    Part,
    Section,
    SlottedProgram,
    slotted,
)
from mujoco_compiled.code.steps import num_operations, results, uses, with_outputs
from mujoco_compiled.code.writer import Writer
from mujoco_compiled.program.program import Program

# Operations. A short program's code is a little faster without slots: on a CPU the ant's took 0.27 µs without
# and 0.36 µs with them. From about this length on it is as fast with them, and compiled sooner.
_LONG = 40_000
# Sections leave no routine that threads share. In them a rodent with 43,600 operations made 37,000 control
# steps/s on an H200; in one piece it makes 172,000.
_LONG_WITH_ROUTINES = 60_000
# Of a program that runs rarely, whose code should be there soon: a rodent's derived fields, 20,000 operations
# with hardly a loop, took LLVM 38 s in one piece and 5 s in sections.
_LONG_AND_RARE = 5_000


@dataclass(frozen=True)
class FunctionFrame:
    """How functions of sections look on a kind of processor. linkage, parameters: in LLVM's words; %slots is
    the first. begin: the lines that each begins with. slots: the type of a pointer to the slots."""

    parameters: str
    begin: Sequence[str]
    slots: str
    linkage: str = "internal"


@dataclass(frozen=True)
class Code:
    """functions: of the sections, `@section0` and so on, each by lines. lines: of the body of the function
    that calls them. block: its last."""

    functions: Sequence[Sequence[str]]
    num_slots: int
    lines: Sequence[str]
    block: str


def is_long(program: Program, *, is_rare: bool = False) -> bool:
    """Whether the program is written in sections. is_rare: whether it runs for a small part of all steps."""
    usual = _LONG_WITH_ROUTINES if program.routines else _LONG
    return num_operations(program.statements) > (_LONG_AND_RARE if is_rare else usual)


def write_code(program: Program, main: Writer, frame: FunctionFrame, section_size: int | None) -> Code:
    """The program in sections of this many operations; None: in one piece."""
    if section_size is None:
        main.write(with_outputs(program))
        return Code([], 0, main.lines, main.block)
    parts = slotted(program, section_size)
    writer = _LongWriter(frame, parts, main, Slots(frame.slots, parts))
    writer.write(parts.parts)
    return Code(writer.functions, parts.num_slots, main.lines, main.block)


@dataclass
class _LongWriter:
    """functions: see `Code`. main: the body of the function that calls them."""

    frame: FunctionFrame
    program: SlottedProgram
    main: Writer
    slots: "Slots"
    functions: list[Sequence[str]] = field(default_factory=list[Sequence[str]])

    def write(self, parts: Sequence[Part]) -> None:
        for part in parts:
            match part:
                case Section():
                    self._call(part)
                case LongLoop():
                    self._loop(part)
                case LongBranch():
                    self._branch(part)

    def _call(self, section: Section) -> None:
        """The section as a function, and a call of it."""
        name, parameters = f"@section{len(self.functions)}", self.frame.parameters
        writer = Writer(self.main.target, self.main.memory, block="body")
        _SectionWriter(writer, self.slots).write(section)
        head = f"define {self.frame.linkage} void {name}({parameters}) noinline nounwind {{"
        self.functions.append([head, "body:", *self.frame.begin, *writer.lines, "  ret void", "}"])
        self.main.line(f"call void {name}({parameters})")

    def _loop(self, loop: LongLoop) -> None:
        main, slots = self.main, self.slots
        head, inside, after = (main.name()[1:] for _ in range(3))
        count, next_count = main.name(), main.name()
        self._call(loop.begin)
        if loop.running is not None:
            slots.store(main, loop.running, main.target.splat("i1", "true"))
        begun = main.block
        main.begin_block(head)
        place = len(main.lines)
        goes_on = main.value(f"icmp slt i32 {count}, {loop.most}")
        if loop.running is not None:
            any_runs = main.any(slots.load(main, loop.running, main.name()))
            goes_on = main.value(f"and i1 {any_runs}, {goes_on}")
        main.line(f"br i1 {goes_on}, label %{inside}, label %{after}")
        main.lines.append(f"{inside}:")
        main.block = inside
        self.write(loop.body)
        self._call(loop.end)
        if loop.running is not None and loop.improves is not None:
            running, improves = (slots.load(main, one, main.name()) for one in (loop.running, loop.improves))
            slots.store(main, loop.running, main.value(f"and {main.target.truth} {running}, {improves}"))
        main.line(f"{next_count} = add i32 {count}, 1")
        main.line(f"br label %{head}")
        main.lines.insert(place, f"  {count} = phi i32 [ 0, %{begun} ], [ {next_count}, %{main.block} ]")
        main.lines.append(f"{after}:")
        main.block = after

    def _branch(self, branch: LongBranch) -> None:
        main = self.main
        inside, after = main.name()[1:], main.name()[1:]
        self._call(branch.begin)
        condition = self.slots.load(main, branch.condition, main.name())
        main.line(f"br i1 {main.any(condition)}, label %{inside}, label %{after}")
        main.lines.append(f"{inside}:")
        main.block = inside
        self.write(branch.body)
        self._call(branch.end)
        main.begin_block(after)


@dataclass(frozen=True)
class Slots:
    """Memory that %slots points to. pointer: its type. A truth value is 1 or 0 in it."""

    pointer: str
    program: SlottedProgram

    def load(self, writer: Writer, variable: int, name: str) -> str:
        """The name, which the number has from now on."""
        target = writer.target
        place = self._place(writer, variable)
        is_truth = variable in self.program.truths
        number = writer.name() if is_truth else name
        writer.line(f"{number} = load {target.number}, {self.pointer} {place}, align {4 * target.width}")
        if is_truth:
            writer.line(f"{name} = fcmp une {target.number} {number}, {target.constant(0.0)}")
        return name

    def store(self, writer: Writer, variable: int, value: str) -> None:
        target = writer.target
        if variable in self.program.truths:
            one, zero = target.constant(1.0), target.constant(0.0)
            value = writer.value(
                f"select {target.truth} {value}, {target.number} {one}, {target.number} {zero}"
            )
        place = self._place(writer, variable)
        writer.line(f"store {target.number} {value}, {self.pointer} {place}, align {4 * target.width}")

    def _place(self, writer: Writer, variable: int) -> str:
        slot = self.program.slots[variable]
        return writer.value(
            f"getelementptr inbounds {writer.target.number}, {self.pointer} %slots, i64 {slot}"
        )


@dataclass
class _SectionWriter:
    """known: the variables that have a name in this function."""

    writer: Writer
    slots: Slots
    known: set[int] = field(default_factory=set[int])

    def write(self, section: Section) -> None:
        for step in section.steps:
            self._load(uses(step))
            self.writer.write([step])
            self._store(results(step))
        self._move(section)

    def _load(self, variables: Iterable[int]) -> None:
        for variable in variables:
            if variable not in self.known:
                self.known.add(variable)
                self.slots.load(self.writer, variable, f"%v{variable}")

    def _store(self, variables: Sequence[int]) -> None:
        self.known.update(variables)
        for variable in variables:
            if variable in self._slots:
                self.slots.store(self.writer, variable, self.writer.operand(variable))

    def _move(self, section: Section) -> None:
        writer = self.writer
        self._load(one for _, one in section.moves)
        values = {variable: writer.operand(one) for variable, one in section.moves}
        # With a width of 1 no mask is needed.
        if section.where is not None and writer.target.width > 1:
            self._load([section.where, *values])
            for variable, value in values.items():
                values[variable] = writer.name()
                writer.select(values[variable], f"%v{section.where}", value, f"%v{variable}")
        for variable, value in values.items():
            self.slots.store(writer, variable, value)

    @property
    def _slots(self) -> Mapping[int, int]:
        return self.slots.program.slots
