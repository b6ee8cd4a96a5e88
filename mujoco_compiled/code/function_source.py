"""A program of one engine with its arrays, from which code for each kind of processor is made."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from mujoco_compiled.code.arrays import array_sizes
from mujoco_compiled.code.kept_code import kept
from mujoco_compiled.program.program import Program

FUNCTION = "move"
# Operations of a section of a long program. LLVM is quickest with short ones, NVIDIA's assembler with few.
_CPU_SECTION, _GPU_SECTION = 250, 2_000


@dataclass(frozen=True)
class Kernel:
    """num_lanes: of an environment. most_warps: of a block. num_envs, shared_bytes: of a block whose threads
    compute routines together, or 0. num_common: see `Memory`."""

    num_lanes: int
    most_warps: int
    num_envs: int
    shared_bytes: int
    num_common: int
    ptx: str


@dataclass(frozen=True)
class FunctionSource:
    """described: what tells it from other programs. write: writes the program; write_lanes: the same for
    several lanes, if the body has limbs that are alike. inputs, outputs: by name, how many numbers of an
    environment an array holds, in the program's order. is_rare: see `is_long`."""

    described: str
    write: Callable[[], Program]
    write_lanes: Callable[[], Program]
    inputs: Mapping[str, int]
    outputs: Mapping[str, int]
    is_rare: bool = False

    def cpu_code(self) -> bytes:
        """An object file for this processor."""
        from mujoco_compiled.code.cpu_function import cpu_function
        from mujoco_compiled.code.long_writer import is_long
        from mujoco_compiled.code.machine_code import machine_code, num_cores, processor, vector_width

        def make() -> bytes:
            program = self._checked(self.write())
            if not is_long(program, is_rare=self.is_rare):
                return machine_code(cpu_function(program, FUNCTION, vector_width()))
            code = cpu_function(program, FUNCTION, vector_width(), _CPU_SECTION, num_cores())
            return machine_code(code, level=1)

        return kept(f"{self.described} for {processor()}", make)

    def kernel(self, compute_capability: str, *, is_lean: bool = False) -> Kernel:
        """For cards of this compute capability. is_lean: see `block_of`."""
        from mujoco_compiled.code.gpu_kernel import block_of, gpu_kernel, most_warps
        from mujoco_compiled.code.long_writer import is_long
        from mujoco_compiled.code.ptx import ptx

        def make() -> bytes:
            program = self._checked(self.write_lanes())
            section_size = _GPU_SECTION if is_long(program) else None
            block = block_of(program, section_size, compute_capability, is_lean=is_lean)
            code = ptx(gpu_kernel(program, FUNCTION, section_size, block), compute_capability)
            lanes, warps = program.num_lanes, most_warps(program, section_size)
            of_block = [block.num_envs, block.shared_bytes] if block else [0, 0]
            sizes = [lanes, warps, *of_block, program.memory.sizes["common"]]
            return f"{' '.join(map(str, sizes))} {code}".encode()

        described = f"{self.described} for {compute_capability}{' in lean blocks' if is_lean else ''}"
        *sizes, code = kept(described, make).decode().split(" ", 5)
        lanes, warps, num_envs, shared_bytes, num_common = map(int, sizes)
        return Kernel(lanes, warps, num_envs, shared_bytes, num_common, code)

    def _checked(self, program: Program) -> Program:
        """Raises ValueError if the program's arrays are others, which would write into foreign memory."""
        expected = {**self.inputs, **{f"to_{name}": size for name, size in self.outputs.items()}}
        found = array_sizes(program)
        if list(found.items()) != list(expected.items()):
            raise ValueError(f"The program's arrays are {found}, and should be {expected}.")
        return program
