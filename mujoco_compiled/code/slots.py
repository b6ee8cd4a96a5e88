"""A long program in sections, with slots in memory for the numbers that several sections need.

A compiler takes much longer than linearly for a function in which thousands of numbers wait to be used. So a
long program becomes many short functions. A number that is used outside of its section is stored to a slot
once it is computed, and loaded in each section that uses it. A slot is used again when its number is dead.
Source: Poletto and Sarkar (1999): linear scan.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from mujoco_compiled.code.steps import Step, num_operations, results, uses, with_outputs
from mujoco_compiled.program.flow import needed
from mujoco_compiled.program.program import (
    Assign,
    Branch,
    Call,
    Each,
    Loop,
    Program,
    Read,
    Statement,
    Store,
    Together,
    assigns,
)

# Written again in each section that uses them: loading them from slots would be no cheaper.
_CONSTANTS = ("constant", "lane_constant")
_TRUTHS = ("less", "and", "not")
# LLVM makes one instruction of a product and its sum.
_FUSED = ("multiply", "negate", "select")
_FUSED_INTO = ("add", "subtract", "negate", "select")


@dataclass(frozen=True)
class Section:
    """Steps, and then moves: (to, from), of variables. All are read before any is written.

    where: the variable that says which environments move; None: all.
    """

    steps: tuple[Step, ...]
    moves: tuple[tuple[int, int], ...] = ()
    where: int | None = None


@dataclass(frozen=True)
class LongLoop:
    """A loop whose body is several parts. running: a variable of its own, true where an environment repeats;
    None: all do. improves: see Loop. begin and end set the carried variables."""

    most: int
    running: int | None
    improves: int | None
    begin: Section
    body: tuple["Part", ...]
    end: Section


@dataclass(frozen=True)
class LongBranch:
    """A branch whose body is several parts. begin sets the results to what they are otherwise."""

    condition: int
    begin: Section
    body: tuple["Part", ...]
    end: Section


Part = Section | LongLoop | LongBranch


@dataclass(frozen=True)
class SlottedProgram:
    """slots: by variable that several parts use. truths: variables that are true or false."""

    parts: tuple[Part, ...]
    slots: Mapping[int, int]
    num_slots: int
    truths: frozenset[int]


def slotted(program: Program, section_size: int) -> SlottedProgram:
    """The program in sections of at most `section_size` operations."""
    # An unused use would hide that a product has a single one; see `_grouped`.
    program = needed(replace(program))
    every = list(assigns(program.statements))
    constants = {one.target: one for one in every if one.operation in _CONSTANTS}
    highest = max((one for each in _all_results(program.statements) for one in each), default=0)
    split = _Split(section_size, constants, highest)
    parts = split.parts(with_outputs(program))
    truths = {one.target for one in every if one.operation in _TRUTHS} | split.running
    slots, num_slots = _allocated(parts)
    return SlottedProgram(parts, slots, num_slots, frozenset(truths))


def _all_results(statements: Sequence[Statement]) -> Iterator[list[int]]:
    for one in statements:
        yield results(one)
        if not isinstance(one, Assign | Read | Store | Call):
            yield from _all_results(one.body)


def _grouped(steps: Sequence[Step]) -> list[list[Step]]:
    """Steps in groups that share a section: a sum, and before it its products that have no other use.

    Parted, they would not be fused, and the numbers would be others than in a program without slots. An
    integer stays with what uses it: it has no slot. Raises ValueError if it is another one there.
    """
    blocks, num_uses = _blocks(steps), Counter(one for step in steps for one in uses(step))
    summed = {
        variable: blocks[step.target]
        for step in steps
        if isinstance(step, Assign) and step.operation in _FUSED_INTO
        for variable in uses(step)
    }
    late, found = dict[int, list[Step]](), list[list[Step]]()
    for step in steps:
        group = [one for variable in uses(step) for one in late.pop(variable, ())] + [step]
        if (isinstance(step, Read) and step.is_integer) or (
            isinstance(step, Assign)
            and step.operation in _FUSED
            and num_uses[step.target] == 1
            and summed.get(step.target) == blocks[step.target]
        ):
            late[step.target] = group
        else:
            waiting = [one for several in late.values() for one in several]
            if _changes_counts([step]) and any(
                isinstance(one, Read) and one.space == "counts" for one in waiting
            ):
                raise ValueError("A list changes between where its length is read and where it is used.")
            found.append(group)
    return found


def _changes_counts(steps: Sequence[Step]) -> bool:
    return any(
        one.space == "counts"
        if isinstance(one, Store)
        else isinstance(one, Loop | Branch | Each | Together) and _changes_counts(one.body)
        for one in steps
    )


def _blocks(steps: Sequence[Step]) -> dict[int, int]:
    """By variable: how many loops and branches are before it."""
    found, block = dict[int, int](), 0
    for step in steps:
        if isinstance(step, Loop | Branch | Each | Together):
            block += 1
        for variable in results(step):
            found[variable] = block
    return found


def _present(variable: int | None) -> list[int]:
    return [] if variable is None else [variable]


@dataclass
class _Split:
    """running: variables that are added for loops."""

    section_size: int
    constants: Mapping[int, Assign]
    num_variables: int
    running: set[int] = field(default_factory=set[int])

    def parts(self, steps: Sequence[Step]) -> tuple[Part, ...]:
        found, waiting, size = list[Part](), list[Step](), 0
        for group in _grouped([one for one in steps if not self._is_constant(one)]):
            own = num_operations(group)
            if waiting and size + own > self.section_size:
                found.append(self._section(waiting))
                waiting, size = [], 0
            if isinstance(group[0], Loop) and own > self.section_size:
                found.append(self._loop(group[0]))
            elif isinstance(group[0], Branch) and own > self.section_size:
                found.append(self._branch(group[0]))
            else:
                waiting += group
                size += own
        return (*found, *([self._section(waiting)] if waiting else []))

    def _is_constant(self, step: Step) -> bool:
        return isinstance(step, Assign) and step.target in self.constants

    def _section(self, steps: Sequence[Step]) -> Section:
        """With the constants that it uses."""
        found, known = list[Step](), set[int]()
        for step in steps:
            for variable in uses(step):
                if variable in self.constants and variable not in known:
                    known.add(variable)
                    found.append(self.constants[variable])
            found.append(step)
        return Section(tuple(found))

    def _moves(self, moves: Sequence[tuple[int, int]], where: int | None = None) -> Section:
        constants = {one: self.constants[one] for _, one in moves if one in self.constants}
        return Section(tuple(constants.values()), tuple(moves), where)

    def _loop(self, loop: Loop) -> LongLoop:
        running = None
        if loop.improves is not None:
            self.num_variables += 1
            running = self.num_variables
            self.running.add(running)
        begin = self._moves([(variable, before) for variable, before, _ in loop.carried])
        end = self._moves([(variable, after) for variable, _, after in loop.carried], running)
        return LongLoop(loop.most, running, loop.improves, begin, self.parts(loop.body), end)

    def _branch(self, branch: Branch) -> LongBranch:
        begin = self._moves([(variable, otherwise) for variable, _, otherwise in branch.results])
        end = self._moves([(variable, inside) for variable, inside, _ in branch.results], branch.condition)
        return LongBranch(branch.condition, begin, self.parts(branch.body), end)


@dataclass
class _Lives:
    """When variables are computed and last needed, in sections from the program's begin."""

    now: int = 0
    begins: dict[int, int] = field(default_factory=dict[int, int])
    ends: dict[int, int] = field(default_factory=dict[int, int])

    def read(self, parts: Sequence[Part]) -> None:
        for part in parts:
            match part:
                case Section():
                    self._section(part)
                case LongLoop():
                    self._loop(part)
                case LongBranch():
                    self._section(part.begin)
                    self._use([part.condition])
                    self.read(part.body)
                    self._section(part.end)

    def _section(self, section: Section) -> None:
        own = set[int]()
        for step in section.steps:
            self._use(one for one in uses(step) if one not in own)
            for variable in results(step):
                own.add(variable)
                self.begins.setdefault(variable, self.now)
        self._use(one for _, one in section.moves if one not in own)
        self._use(_present(section.where))
        for variable, _ in section.moves:
            self.begins.setdefault(variable, self.now)
            self._use([variable])
        self.now += 1

    def _loop(self, loop: LongLoop) -> None:
        begun = self.now
        for variable in _present(loop.running):
            self.begins[variable] = begun
        self._section(loop.begin)
        outer, self.ends = self.ends, {}
        self.read(loop.body)
        self._section(loop.end)
        self._use([*_present(loop.running), *_present(loop.improves)])
        inner, self.ends = self.ends, outer
        for variable, end in inner.items():
            # The next repetition needs again what was computed before the loop.
            self.ends[variable] = self.now if self.begins[variable] <= begun else end
        # Where the loop decides whether to repeat.
        self.now += 1

    def _use(self, variables: Iterator[int] | Sequence[int]) -> None:
        for variable in variables:
            self.ends[variable] = self.now


def _allocated(parts: Sequence[Part]) -> tuple[dict[int, int], int]:
    """Slots by variable, and how many there are. A slot is free after its variable's last section."""
    lives = _Lives()
    lives.read(parts)
    ending: dict[int, list[int]] = {}
    slots, free, num_slots, freed = dict[int, int](), list[int](), 0, 0
    for variable, begin in lives.begins.items():
        if variable not in lives.ends:
            continue
        while freed < begin:
            free += ending.pop(freed, ())
            freed += 1
        if free:
            slots[variable] = free.pop()
        else:
            slots[variable], num_slots = num_slots, num_slots + 1
        ending.setdefault(lives.ends[variable], []).append(slots[variable])
    return slots, num_slots
