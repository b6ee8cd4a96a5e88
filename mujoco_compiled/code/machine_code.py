"""Machine code for this processor, from LLVM's language. Needs the extra `compiled`."""

import ctypes
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import llvmlite.binding as llvm
import numpy as np
from numpy.typing import NDArray

Level = Literal[1, 2]


@dataclass(frozen=True)
class Function:
    """A compiled function of arrays; it lives as long as its engine."""

    engine: Any
    pointer: Any

    def __call__(self, first: int, end: int, *arrays: NDArray[np.float32]) -> None:
        """Moves the environments from first to end - 1; see `cpu_function`. Other threads run meanwhile."""
        self.pointer(first, end, *(array.ctypes.data for array in arrays))


@cache
def vector_width() -> int:
    """How many float32 a vector of this processor holds."""
    features: Any = llvm.get_host_cpu_features()
    if features.get("avx512f"):
        return 16
    return 8 if features.get("avx") else 4


def processor() -> str:
    """The processor that the code is made for."""
    return f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"


def machine_code(module: str, level: Level = 2) -> bytes:
    """An object file for this processor. Raises RuntimeError for a wrong module. level: LLVM's, of its code
    generator.

    LLVM's general passes are left out: they find nothing in a program that has no needless operation, and
    take as long as the rest.
    """
    parsed: Any = llvm.parse_assembly(module)
    parsed.verify()
    return _machine(level).emit_object(parsed)


def loaded(code: bytes, name: str, num_arrays: int) -> Function:
    """The function of an object file that `machine_code` made."""
    engine: Any = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    kind = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * num_arrays)
    return Function(engine, kind(engine.get_function_address(name)))


def _machine(level: Level = 2) -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    # Code of several megabytes may lie farther from where it is called than a short jump reaches.
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=level,
        codemodel="jitdefault",
        jit=True,
    )
