"""A program as a kernel for NVIDIA's GPUs, with an environment in each thread."""

from collections.abc import Mapping
from dataclasses import dataclass

from core.physics.compiled.code.arrays import array_sizes
from core.physics.compiled.code.writer import Target, Writer
from core.physics.compiled.program import Program

TRIPLE = "nvptx64-nvidia-cuda"
_TARGET = Target(1, allowed="afn arcp")


@dataclass(frozen=True)
class _Rows:
    """Arrays [environments, size] in the card's memory."""

    sizes: Mapping[str, int]

    def load(self, writer: Writer, target: str, name: str, place: int) -> None:
        pointer = self._pointer(writer, name, place)
        writer.line(f"{target} = load float, ptr addrspace(1) {pointer}, !invariant.load !0")

    def store(self, writer: Writer, name: str, place: int, value: str) -> None:
        writer.line(f"store float {value}, ptr addrspace(1) {self._pointer(writer, name, place)}")

    def _pointer(self, writer: Writer, name: str, place: int) -> str:
        row = f"[{self.sizes[name]} x float]"
        return writer.value(f"getelementptr {row}, ptr addrspace(1) %{name}, i64 %environment, i64 {place}")


def gpu_kernel(program: Program, name: str, threads: int) -> str:
    """A module with the kernel `name(count, inputs..., outputs...)`, in the program's order.

    count: a pointer to the number of environments, int32. An input or output is a pointer to float32
    [environments, size]. threads: of a block.
    """
    sizes = array_sizes(program)
    writer = Writer(_TARGET, _Rows(sizes), block="body")
    writer.write(program.statements)
    for output, variables in program.outputs.items():
        for place, variable in enumerate(variables):
            writer.memory.store(writer, f"to_{output}", place, f"%v{variable}")
    arrays = ", ".join(f"ptr addrspace(1) noalias %{one}" for one in sizes)
    read = "declare i32 @llvm.nvvm.read.ptx.sreg"
    return "\n".join(
        [
            f'target triple = "{TRIPLE}"',
            *_TARGET.declarations(),
            *(f"{read}.{register}()" for register in ("tid.x", "ctaid.x")),
            f"define ptx_kernel void @{name}(ptr addrspace(1) %count, {arrays}) "
            f'"nvvm.maxntid"="{threads}" {{',
            "entry:",
            "  %thread = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()",
            "  %block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()",
            f"  %before = mul i32 %block, {threads}",
            "  %number = add i32 %before, %thread",
            "  %environment = zext i32 %number to i64",
            "  %environments = load i32, ptr addrspace(1) %count",
            "  %exists = icmp slt i32 %number, %environments",
            "  br i1 %exists, label %body, label %done",
            "body:",
            *writer.lines,
            "  br label %done",
            "done:",
            "  ret void",
            "}",
            "!0 = !{}",
            "",
        ]
    )
