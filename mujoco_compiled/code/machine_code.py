"""Machine code for this processor, from LLVM's language. Needs the extra `compiled`."""

import ctypes
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Literal

import llvmlite.binding as llvm
import numpy as np
from llvmlite.binding import ffi
from numpy.typing import NDArray

Level = Literal[1, 2]
_LENGTH_BYTES = 8


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


def num_cores() -> int:
    """The CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def processor() -> str:
    """The processor that the code is made for."""
    return f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"


def machine_code(modules: Sequence[str], level: Level = 2) -> bytes:
    """Object files for this processor, one after the other, each behind its length; modules are compiled side
    by side. Raises RuntimeError for a wrong module. level: LLVM's, of its code generator.

    LLVM's general passes are left out: they find nothing in a program that has no needless operation, and
    take as long as the rest.
    """
    with ThreadPoolExecutor(len(modules)) as pool:
        objects = list(pool.map(partial(_object_file, level=level), modules))
    return b"".join(len(one).to_bytes(_LENGTH_BYTES, "little") + one for one in objects)


def loaded(code: bytes, name: str, num_arrays: int) -> Function:
    """The function of the object files that `machine_code` made."""
    engine: Any = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine())
    while code:
        end = _LENGTH_BYTES + int.from_bytes(code[:_LENGTH_BYTES], "little")
        engine.add_object_file(llvm.ObjectFileRef.from_data(code[_LENGTH_BYTES:end]))
        code = code[end:]
    engine.finalize_object()
    kind = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * num_arrays)
    return Function(engine, kind(engine.get_function_address(name)))


def _object_file(module: str, level: Level) -> bytes:
    # Modules of one context may not be compiled side by side.
    parsed: Any = llvm.parse_assembly(module, llvm.create_context())
    parsed.verify()
    message = ctypes.c_char_p()
    if not (buffer := _emit()(_machine(level), parsed, 1, ctypes.byref(message))):
        raise RuntimeError((message.value or b"LLVM made no code.").decode())
    try:
        return ctypes.string_at(ffi.lib.LLVMPY_GetBufferStart(buffer), ffi.lib.LLVMPY_GetBufferSize(buffer))
    finally:
        ffi.lib.LLVMPY_DisposeMemoryBuffer(buffer)


@cache
def _emit() -> Any:
    """What llvmlite's `emit_object` calls, without the lock under which it lets one thread into LLVM."""
    library: Any = ffi.lib
    locked = library.LLVMPY_TargetMachineEmitToMemory
    emit = ctypes.CDLL(library._name, handle=library._handle).LLVMPY_TargetMachineEmitToMemory
    emit.argtypes, emit.restype = locked.argtypes, locked.restype
    return emit


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
