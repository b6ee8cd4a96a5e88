"""Where the spaces of a program's memory are; see `Space`."""

from collections.abc import Iterator, Sequence

from mujoco_compiled.code.writer import Target
from mujoco_compiled.program.program import Memory


def tables(memory: Memory, target: Target, linkage: str = "internal") -> Iterator[str]:
    """LLVM's definitions of what is the model's. linkage: in LLVM's words."""
    kind = f"{linkage} {target.shared.removeprefix('ptr').strip()}"
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
    yield from _room("numbers", target.number, memory.num_numbers, target.own)
    yield from _room("counts", "i32", memory.num_counts, target.own)


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
