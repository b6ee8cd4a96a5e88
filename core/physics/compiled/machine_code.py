"""Machine code for this processor, from LLVM's language. Needs the extra `compiled`."""

import ctypes
from dataclasses import dataclass
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Function:
    """A compiled function of arrays; it lives as long as its engine."""

    engine: Any
    pointer: Any

    def __call__(self, first: int, end: int, *arrays: NDArray[np.float32]) -> None:
        """Moves the environments from first to end - 1; see `llvm.function`. Other threads run meanwhile."""
        self.pointer(first, end, *(array.ctypes.data for array in arrays))


def compiled(module: str, name: str, num_arrays: int) -> Function:
    """The function of a module, optimised for this processor. Raises RuntimeError for a wrong module."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine: Any = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=2
    )
    parsed: Any = llvm.parse_assembly(module)
    parsed.verify()
    passes: Any = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    passes.getModulePassManager().run(parsed, passes)
    engine: Any = llvm.create_mcjit_compiler(parsed, machine)
    engine.finalize_object()
    kind = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * num_arrays)
    return Function(engine, kind(engine.get_function_address(name)))
