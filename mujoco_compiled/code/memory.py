"""Where the spaces of a program's memory are; see `Space`."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

from mujoco_compiled.code.target import SmallTables, Target
from mujoco_compiled.program.program import Each, Memory, Program, Read, Statement

# What a card's constant memory holds, in bytes, and leaves for a kernel's parameters.
_MOST_SMALL = 60_000


def tables(memory: Memory, target: Target, linkage: str = "internal") -> Iterator[str]:
    """LLVM's definitions of what is the model's. linkage: in LLVM's words."""
    kind = f"{linkage} {target.tables.removeprefix('ptr').strip()}"
    one = Target(1, allowed="")
    constants = [f"float {one.constant(value)}" for value in memory.constants]
    yield _table("table_constants", kind, "float", constants)
    yield _table("table_integers", kind, "i32", [f"i32 {value}" for value in memory.integers])


def foreign_tables(memory: Memory) -> Iterator[str]:
    """Declarations of the tables that another module of a CPU's code has."""
    yield f"@table_constants = external constant [{len(memory.constants)} x float], align 64"
    yield f"@table_integers = external constant [{len(memory.integers)} x i32], align 64"


def memory_lines(memory: Memory, target: Target) -> Iterator[str]:
    """The begin of a function that makes room for what an environment, or several together, have."""
    yield from _room("numbers", target.number, memory.sizes["numbers"], target.own)
    yield from _room("counts", "i32", memory.num_counts, target.own)
    if target.team is None:
        yield from _room("shared", target.number, memory.sizes["shared"], target.shared)
        yield from _room("common", target.number, memory.sizes["common"], target.common)


def _room(name: str, element: str, number: int, kind: str) -> Iterator[str]:
    """Always there: sections of a long program are passed it."""
    room = f"alloca [{max(number, 1)} x {element}]"
    if kind == "ptr":
        yield f"  %{name} = {room}, align 64"
    else:
        yield f"  %{name}_room = {room}, align 4"
        yield f"  %{name} = addrspacecast ptr %{name}_room to {kind}"


def _table(name: str, kind: str, element: str, values: Sequence[str]) -> str:
    content = f"[{', '.join(values)}]" if values else "zeroinitializer"
    return f"@{name} = {kind} constant [{len(values)} x {element}] {content}, align 64"


def small_tables(program: Program) -> SmallTables | None:
    """The tables that routines read, as integers of 16 bits; None: there is no room for them."""
    memory = program.memory
    used = {offset for body in program.routines.values() for offset in _offsets(body)}
    places, values = dict[int, int](), list[int]()
    for begin, end in pairwise([*memory.tables, len(memory.integers)]):
        if own := [offset for offset in used if begin <= offset < end]:
            places |= {offset: len(values) + offset - begin for offset in own}
            values += memory.integers[begin:end]
    is_small = 2 * len(values) <= _MOST_SMALL and all(0 <= value < 1 << 15 for value in values)
    return SmallTables(places, values) if is_small else None


def _offsets(body: Sequence[Statement]) -> Iterator[int]:
    """Where the reads of tables begin."""
    for one in body:
        if isinstance(one, Read) and one.space == "integers":
            yield one.place.offset
        elif isinstance(one, Each):
            yield from _offsets(one.body)


def small_table(tables: SmallTables) -> str:
    """LLVM's definition of them."""
    return _table(
        "small_integers", "internal addrspace(4)", "i16", [f"i16 {value}" for value in tables.values]
    )
