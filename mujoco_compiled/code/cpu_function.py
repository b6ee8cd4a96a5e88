"""A program as a function for a CPU, with an environment in each lane of a vector."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

from mujoco_compiled.code.arrays import array_sizes
from mujoco_compiled.code.long_writer import FunctionFrame, write_code
from mujoco_compiled.code.memory import foreign_tables, memory_lines, tables
from mujoco_compiled.code.target import Target
from mujoco_compiled.code.writer import Writer, routines
from mujoco_compiled.program.program import Program

_WHOLE = "A vector's lanes are environments: the program must be a whole body's."


@dataclass(frozen=True)
class _CpuRows:
    """Arrays [environments, size]; lanes without an environment are neither read nor written."""

    sizes: Mapping[str, int]

    def load(self, writer: Writer, target: str, name: str, places: Sequence[int]) -> None:
        width, number, truth = writer.target.width, writer.target.number, writer.target.truth
        pointers = self._pointers(writer, name, places[0])
        writer.line(
            f"{target} = call {number} @llvm.masked.gather.v{width}f32.v{width}p0("
            f"<{width} x ptr> {pointers}, i32 4, {truth} %exists, {number} zeroinitializer)"
        )

    def store(self, writer: Writer, name: str, places: Sequence[int], value: str) -> None:
        width, number, truth = writer.target.width, writer.target.number, writer.target.truth
        pointers = self._pointers(writer, name, places[0])
        writer.line(
            f"call void @llvm.masked.scatter.v{width}f32.v{width}p0("
            f"{number} {value}, <{width} x ptr> {pointers}, i32 4, {truth} %exists)"
        )

    def lane_constant(self, writer: Writer, target: str, values: Sequence[float]) -> None:
        raise NotImplementedError(_WHOLE)

    def lane_sum(self, writer: Writer, target: str, value: str) -> None:
        raise NotImplementedError(_WHOLE)

    def _pointers(self, writer: Writer, name: str, place: int) -> str:
        """Where each lane's environment has this number."""
        first = writer.value(f"getelementptr float, ptr %{name}, i64 {place}")
        lanes = f"<{writer.target.width} x i64> %environments"
        return writer.value(f"getelementptr [{self.sizes[name]} x float], ptr {first}, {lanes}")


def cpu_function(
    program: Program, name: str, width: int, section_size: int | None = None, num_parts: int = 1
) -> list[str]:
    """Modules with `void name(i64 first, i64 end, inputs..., outputs...)`, in the program's order.

    It moves the environments from first to end - 1, `width` at a time. An input or output is a pointer to
    float32 [environments, size]. section_size: see `write_code`. num_parts: modules to which sections are
    shared out, so that they can be compiled side by side.
    """
    sizes = array_sizes(program)
    target = Target(width, allowed="")
    lanes = target.of("i64")
    order = ", ".join(f"i64 {lane}" for lane in range(width))
    arrays = ", ".join(f"ptr noalias %{one}" for one in sizes)
    environments = [
        f"  %ends = insertelement {lanes} poison, i64 %end, i64 0",
        f"  %limit = shufflevector {lanes} %ends, {lanes} poison, <{width} x i32> zeroinitializer",
        f"  %begins = insertelement {lanes} poison, i64 %begin, i64 0",
        f"  %all = shufflevector {lanes} %begins, {lanes} poison, <{width} x i32> zeroinitializer",
        f"  %environments = add {lanes} %all, <{order}>",
        f"  %exists = icmp slt {lanes} %environments, %limit",
    ]
    memory = memory_lines(program.memory, target)
    pointers = "ptr %slots, ptr %numbers, ptr %counts, ptr %shared, ptr %common"
    parameters, rows = f"{pointers}, i64 %begin, i64 %end, {arrays}", _CpuRows(sizes)
    frame = FunctionFrame(parameters, environments, slots="ptr", linkage="")
    code = write_code(program, Writer(target, rows, block="group"), frame, section_size)
    declarations = [*target.declarations(), *_declarations(target)]
    parts = [code.functions[part::num_parts] for part in range(min(num_parts, len(code.functions)))]
    return [
        _module(
            *declarations,
            *tables(program.memory, target, linkage=""),
            *routines(program, target, rows),
            *(f"declare void @section{k}({parameters})" for k in range(len(code.functions))),
            f"define void @{name}(i64 %first, i64 %end, {arrays}) {{",
            "entry:",
            *([f"  %slots = alloca {target.number}, i32 {code.num_slots}"] if code.functions else []),
            *memory,
            "  br label %next",
            "next:",
            f"  %begin = phi i64 [ %first, %entry ], [ %following, %{code.block} ]",
            "  %is_left = icmp slt i64 %begin, %end",
            "  br i1 %is_left, label %group, label %done",
            "group:",
            *environments,
            *code.lines,
            f"  %following = add i64 %begin, {width}",
            "  br label %next",
            "done:",
            "  ret void",
            "}",
        ),
        *(
            _module(*declarations, *foreign_tables(program.memory), *chain.from_iterable(part))
            for part in parts
        ),
    ]


def _module(*lines: str) -> str:
    return "\n".join([*lines, "!0 = !{}", ""])


def _declarations(target: Target) -> list[str]:
    """LLVM's declarations of the functions that `_CpuRows` calls."""
    pointers, kind = target.of("ptr"), f"v{target.width}f32.v{target.width}p0"
    return [
        f"declare {target.number} @llvm.masked.gather.{kind}"
        f"({pointers}, i32, {target.truth}, {target.number})",
        f"declare void @llvm.masked.scatter.{kind}({target.number}, {pointers}, i32, {target.truth})",
    ]
