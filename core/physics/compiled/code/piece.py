"""A program of one engine with its arrays, from which code for each kind of processor is made."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from core.physics.compiled.code.arrays import array_sizes
from core.physics.compiled.code.kept_code import kept
from core.physics.compiled.program import Program

FUNCTION = "move"


@dataclass(frozen=True)
class Piece:
    """described: what tells it from other programs. write: writes the program. inputs, outputs: by name, how
    many numbers of an environment an array holds, in the program's order."""

    described: str
    write: Callable[[], Program]
    inputs: Mapping[str, int]
    outputs: Mapping[str, int]

    def cpu_code(self) -> bytes:
        """An object file for this processor."""
        from core.physics.compiled.code.cpu_function import cpu_function
        from core.physics.compiled.code.machine_code import machine_code, processor, vector_width

        def make() -> bytes:
            return machine_code(cpu_function(self._written(), FUNCTION, vector_width()))

        return kept(f"{self.described} for {processor()}", make)

    def gpu_code(self, compute_capability: str, num_threads: int) -> str:
        """PTX for cards of this compute capability, with blocks of this many threads."""
        from core.physics.compiled.code.gpu_kernel import gpu_kernel
        from core.physics.compiled.code.ptx import ptx

        def make() -> bytes:
            return ptx(gpu_kernel(self._written(), FUNCTION, num_threads), compute_capability).encode()

        return kept(f"{self.described} for {compute_capability} in {num_threads}", make).decode()

    def _written(self) -> Program:
        """The program. Raises ValueError if its arrays are others, which would write into foreign memory."""
        program = self.write()
        expected = {**self.inputs, **{f"to_{name}": size for name, size in self.outputs.items()}}
        found = array_sizes(program)
        if list(found.items()) != list(expected.items()):
            raise ValueError(f"The program's arrays are {found}, and should be {expected}.")
        return program
